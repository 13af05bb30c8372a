#pragma once

#include <vector>

#include <drjit/math.h>

#include "glimt-mitsuba/src/bridge.rs.h"

namespace glimt {

namespace dr = drjit;

template <typename Float> Float activate(core::Activation activation, const Float &x) {
    if (activation == core::Activation::Relu)
        return dr::maximum(x, 0.f);
    // HardGELU: the parabola on the limited x, and the rest of x on top.
    Float t = dr::clip(x, -1.5f, 1.5f);
    return dr::fmadd(t * (t + 1.5f), 1.f / 3.f, dr::maximum(x - 1.5f, 0.f));
}

/**
 * \brief W x + b with the weights as literals of the kernel
 *
 * Literals cost compile time (seconds for 2,500 of them) but no memory traffic: weights that are
 * gathered inside a virtual function call become masked gathers, which are slower by far.
 */
template <typename Float>
std::vector<Float> affine(const core::Layer &layer, const std::vector<Float> &x) {
    std::vector<Float> y;
    y.reserve(layer.bias.size());
    auto weight = layer.weight.begin();
    for (float bias : layer.bias) {
        Float sum = bias;
        for (const Float &input : x)
            sum = dr::fmadd(Float(*weight++), input, sum);
        y.push_back(sum);
    }
    return y;
}

/// The outputs of a multilayer perceptron.
template <typename Float>
std::vector<Float> forward(const core::Network &network, std::vector<Float> x) {
    for (size_t i = 0; i < network.layers.size(); ++i) {
        x = affine(network.layers[i], x);
        if (i + 1 < network.layers.size())
            for (Float &value : x)
                value = activate(network.activation, value);
    }
    return x;
}

} // namespace glimt
