//! The networks that fits offer, and what they are before training.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use crate::backprop::Shape;

/// Hidden layers of a network: width × number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Net {
    /// Neurons in a layer.
    pub width: usize,
    /// Hidden layers.
    pub layers: usize,
}

impl Net {
    /// Whether fits offer it: 16, 32 or 64 neurons in 2 or 3 layers.
    #[must_use]
    pub fn is_supported(self) -> bool {
        matches!(self.width, 16 | 32 | 64) && matches!(self.layers, 2 | 3)
    }

    pub(crate) fn hidden(self) -> Vec<usize> {
        vec![self.width; self.layers]
    }

    /// Whether fits offer it with a latent code of so many numbers; if not, why.
    pub(crate) fn check(self, latent: usize) -> Result<(), String> {
        const MOST_LATENT: usize = 32;
        if !self.is_supported() {
            let Net { width, layers } = self;
            return Err(format!("the network is {width}x{layers}, expected 16, 32 or 64 times 2 or 3"));
        }
        if latent > MOST_LATENT {
            return Err(format!("the latent code has {latent} numbers, expected at most {MOST_LATENT}"));
        }
        Ok(())
    }
}

/// Why materials of one network need a latent code.
pub(crate) const NEEDS_CODE: &str =
    "a latent code of 0 numbers cannot tell the materials of one network apart";

/// Uniform in [-1, 1).
pub(crate) fn symmetric(rng: &mut impl Rng) -> f32 {
    2.0 * rng.random::<f32>() - 1.0
}

/// Weights and biases uniform in ±1/√inputs, PyTorch's default.
pub(crate) fn random_layers(shape: &Shape, rng: &mut impl Rng) -> Vec<f32> {
    let mut numbers = Vec::with_capacity(shape.len());
    for layer in 0..shape.layers() {
        let (inputs, outputs) = shape.layer(layer);
        let bound = 1.0 / (inputs as f32).sqrt();
        numbers.extend((0..(inputs + 1) * outputs).map(|_| bound * symmetric(rng)));
    }
    numbers
}
