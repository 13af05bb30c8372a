//! Linear sRGB to reflectance spectra: f(λ) = r R(λ) + g G(λ) + b B(λ).
//!
//! R, G and B are smooth reflectance spectra that sum to 1 and have the colours (1, 0, 0), (0, 1, 0) and (0, 0, 1)
//! under D65 (Mallett & Yuksel 2019, *Spectral Primary Decomposition for Rendering with sRGB Reflectance*). The map
//! is linear, and so it holds for values of any size, which the values of a BRDF have; it adds no energy at any
//! wavelength. It is the map of the Mitsuba plugin in spectral variants.

use glam::Vec3;

/// Wavelength of the first node in nm.
const FIRST: f32 = 360.0;
/// Nanometres between nodes.
const STEP: f32 = 10.0;
/// R and G at the nodes; B is the rest. Made by plugin/fit_primaries.py.
#[rustfmt::skip]
const RED_GREEN: [[f32; 2]; 48] = [
    [0.028423, 0.000000],
    [0.028422, 0.000000],
    [0.028417, 0.000000],
    [0.028397, 0.000000],
    [0.028323, 0.000000],
    [0.028028, 0.000000],
    [0.027015, 0.000000],
    [0.024317, 0.000000],
    [0.020112, 0.000000],
    [0.018495, 0.000000],
    [0.029206, 0.000000],
    [0.011963, 0.109361],
    [0.000000, 0.294856],
    [0.000000, 0.507918],
    [0.000000, 0.716290],
    [0.000000, 0.887916],
    [0.000000, 0.991154],
    [0.000000, 1.000000],
    [0.000000, 1.000000],
    [0.000000, 1.000000],
    [0.000000, 1.000000],
    [0.015126, 0.937912],
    [0.206164, 0.741808],
    [0.477606, 0.488047],
    [0.739564, 0.248065],
    [0.924770, 0.075230],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
    [1.000000, 0.000000],
];

/// How far a node may be from the line between its neighbours to be left out.
const ON_A_LINE: f32 = 2e-3;

/// A wavelength, and R, G and B there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Wavelength in nm.
    pub wavelength: f32,
    /// The three spectra, of which the colour's channels are the weights.
    pub weights: Vec3,
}

impl Node {
    fn new(index: usize) -> Node {
        let [red, green] = RED_GREEN[index];
        Node {
            wavelength: FIRST + STEP * index as f32,
            weights: Vec3::new(red, green, (1.0 - red - green).max(0.0)),
        }
    }

    fn between(a: Node, b: Node, wavelength: f32) -> Vec3 {
        a.weights.lerp(b.weights, (wavelength - a.wavelength) / (b.wavelength - a.wavelength))
    }
}

/// As few nodes as tell the spectra, which are linear between them; the first and the last one end the visible
/// range.
#[must_use]
pub fn nodes() -> Vec<Node> {
    let all: Vec<Node> = (0..RED_GREEN.len()).map(Node::new).collect();
    let mut kept = vec![0];
    while let Some(&from) = kept.last().filter(|&&last| last + 1 < all.len()) {
        let spans = |to: usize| {
            all[from..=to].iter().all(|node| {
                let line = Node::between(all[from], all[to], node.wavelength);
                (line - node.weights).abs().max_element() <= ON_A_LINE
            })
        };
        // The farthest node that a line from the last one reaches.
        let reached = (from + 1..all.len()).take_while(|&to| spans(to)).last();
        kept.push(reached.unwrap_or(from + 1));
    }
    kept.into_iter().map(|index| all[index]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectrum;

    #[test]
    fn the_plugin_has_the_same_table() {
        let header = include_str!("../../../plugin/src/primaries.h");
        let (_, table) = header.split_once("RedGreen[2 * Count] = {").unwrap();
        let (table, _) = table.split_once('}').unwrap();
        let numbers = table.split(',').map(str::trim).filter(|number| !number.is_empty());
        let numbers: Vec<f32> = numbers.map(|number| number.trim_end_matches('f').parse().unwrap()).collect();
        assert_eq!(numbers, RED_GREEN.as_flattened());
    }

    #[test]
    fn few_nodes_tell_the_spectra() {
        let nodes = nodes();
        assert!(nodes.len() < 36, "{}", nodes.len());
        assert_eq!([nodes[0].wavelength, nodes[nodes.len() - 1].wavelength], [360.0, 830.0]);
        for index in 0..RED_GREEN.len() {
            let whole = Node::new(index);
            let next = nodes.iter().position(|node| node.wavelength >= whole.wavelength).unwrap().max(1);
            let line = Node::between(nodes[next - 1], nodes[next], whole.wavelength);
            assert!((line - whole.weights).abs().max_element() <= 1.01 * ON_A_LINE, "{whole:?} {line}");
        }
    }

    #[test]
    fn the_spectrum_of_a_colour_has_that_colour() {
        let nodes = nodes();
        let wavelengths: Vec<f32> = nodes.iter().map(|node| node.wavelength).collect();
        let to_srgb = spectrum::to_srgb(&wavelengths);
        for rgb in [Vec3::ONE, Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(3.0, 0.2, 0.05)] {
            let found: Vec3 =
                to_srgb.iter().zip(&nodes).map(|(weight, node)| *weight * node.weights.dot(rgb)).sum();
            // The observer here is a fit to that of the primaries.
            assert!((found - rgb).abs().max_element() < 0.01 * rgb.max_element(), "{found} for {rgb}");
        }
    }
}
