//! AdamW (Loshchilov & Hutter 2019): Adam with decoupled weight decay.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// Settings of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdamW {
    /// Decay of the mean of the gradient.
    pub beta1: f32,
    /// Decay of the mean of its square.
    pub beta2: f32,
    /// Weight decay per unit of learning rate.
    pub weight_decay: f32,
}

impl AdamW {
    /// The defaults of PyTorch, which the paper used.
    pub const PAPER: AdamW = AdamW { beta1: 0.9, beta2: 0.999, weight_decay: 0.01 };
}

/// Added to the root of the mean square, so that numbers with no gradient stay where they are.
const EPSILON: f32 = 1e-8;

/// What the optimiser keeps of the steps that were.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Mean of the gradient, for each number.
    pub first: Vec<f32>,
    /// Mean of its square, for each number.
    pub second: Vec<f32>,
    /// For each row of the materials' tables, the steps that touched it.
    pub touched: Vec<u32>,
}

impl Moments {
    /// For `n` numbers and `rows` of tables among them that have not moved yet.
    #[must_use]
    pub fn new(n: usize, rows: usize) -> Self {
        Moments { first: vec![0.0; n], second: vec![0.0; n], touched: vec![0; rows] }
    }

    /// The means of some of the numbers: of the gradient, and of its square.
    pub fn of(&mut self, numbers: Range<usize>) -> [&mut [f32]; 2] {
        [&mut self.first[numbers.clone()], &mut self.second[numbers]]
    }
}

impl AdamW {
    /// Moves `numbers`, whose means are `first` and `second`, against `gradient`. `step` counts the steps that moved
    /// them from 1, and `decays` says which of them weight decay pulls to 0.
    pub fn update(
        &self,
        numbers: &mut [f32],
        gradient: &[f32],
        [first, second]: [&mut [f32]; 2],
        step: u64,
        rate: f32,
        decays: impl Fn(usize) -> bool,
    ) {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        let first_correction = 1.0 / (1.0 - f64::from(self.beta1).powi(step)) as f32;
        let second_correction = 1.0 / (1.0 - f64::from(self.beta2).powi(step)) as f32;
        for (i, (number, &g)) in numbers.iter_mut().zip(gradient).enumerate() {
            let (m, v) = (&mut first[i], &mut second[i]);
            *m += (1.0 - self.beta1) * (g - *m);
            *v += (1.0 - self.beta2) * (g * g - *v);
            if decays(i) {
                *number -= rate * self.weight_decay * *number;
            }
            *number -= rate * (*m * first_correction) / ((*v * second_correction).sqrt() + EPSILON);
        }
    }
}

/// Scales `gradient` so that its Euclidean norm is at most `limit`; returns the norm it had.
pub fn clip_norm(gradient: &mut [f32], limit: f32) -> f32 {
    let norm = gradient.iter().map(|&g| f64::from(g) * f64::from(g)).sum::<f64>().sqrt() as f32;
    if norm > limit {
        let scale = limit / norm;
        gradient.iter_mut().for_each(|g| *g *= scale);
    }
    norm
}

/// The learning rate at `step` of `steps`: a cosine from `rate` to 0.
#[must_use]
pub fn cosine_decay(rate: f32, step: u64, steps: u64) -> f32 {
    let t = step as f64 / steps as f64;
    (f64::from(rate) * 0.5 * (1.0 + (std::f64::consts::PI * t).cos())) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_step_has_the_length_of_the_rate() {
        let mut numbers = [1.0, -2.0];
        let mut moments = Moments::new(2, 0);
        AdamW { weight_decay: 0.0, ..AdamW::PAPER }.update(
            &mut numbers,
            &[3.0, -0.01],
            moments.of(0..2),
            1,
            0.1,
            |_| true,
        );
        assert!((numbers[0] - 0.9).abs() < 1e-5 && (numbers[1] + 1.9).abs() < 1e-5, "{numbers:?}");
    }

    #[test]
    fn weight_decay_is_decoupled_and_selective() {
        let mut numbers = [1.0, 1.0];
        let mut moments = Moments::new(2, 0);
        AdamW::PAPER.update(&mut numbers, &[0.0, 0.0], moments.of(0..2), 1, 0.5, |i| i == 0);
        assert_eq!(numbers, [1.0 - 0.5 * 0.01, 1.0]);
    }

    #[test]
    fn a_quadratic_bowl_is_descended_to_its_bottom() {
        let mut numbers = [5.0f32, -3.0];
        let mut moments = Moments::new(2, 0);
        for step in 1..=2000 {
            let gradient = [2.0 * (numbers[0] - 1.0), 200.0 * (numbers[1] - 2.0)];
            let rate = cosine_decay(0.05, step - 1, 2000);
            AdamW { weight_decay: 0.0, ..AdamW::PAPER }.update(
                &mut numbers,
                &gradient,
                moments.of(0..2),
                step,
                rate,
                |_| true,
            );
        }
        assert!((numbers[0] - 1.0).abs() < 1e-3 && (numbers[1] - 2.0).abs() < 1e-3, "{numbers:?}");
    }

    #[test]
    fn clipping_keeps_the_direction() {
        let mut gradient = [3.0, 4.0];
        assert_eq!(clip_norm(&mut gradient, 1.0), 5.0);
        assert_eq!(gradient, [0.6, 0.8]);
        assert_eq!(clip_norm(&mut gradient, 2.0), 1.0);
        assert_eq!(gradient, [0.6, 0.8]);
    }

    #[test]
    fn cosine_decay_goes_from_the_rate_to_nothing() {
        assert_eq!(cosine_decay(0.1, 0, 10), 0.1);
        assert!((cosine_decay(0.1, 5, 10) - 0.05).abs() < 1e-7);
        assert!(cosine_decay(0.1, 10, 10) < 1e-7);
    }
}
