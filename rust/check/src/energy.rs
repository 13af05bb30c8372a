//! How much light leaves: the sampler's answer against the integral, and the directional albedo.

use glam::DVec3;

use crate::look::Look;
use crate::statistics::{Moments, least_of, one_sided, two_sided};
use crate::verdict::{Finding, Measure, Test};

/// Relative error that quadrature of the response may have.
const QUADRATURE: f64 = 3e-3;
/// Albedo beyond 1 that rounding may cause.
const ROUNDING: f64 = 1e-3;
/// Share of the albedo without a density that is worth a warning.
const UNCOVERED: f64 = 1e-4;

/// [`Test::Unbiased`]: the mean weight against ∫ f cosθ by quadrature, delta components left out.
///
/// The standard error is the greater of the samples' own and that of the second moment by quadrature: a
/// sampler that draws a bright lobe too rarely to have seen it has a small error in its own eyes.
#[must_use]
pub fn unbiased(look: &Look) -> Finding {
    let finding = |measure| Finding::new(Test::Unbiased, measure).at(look.view);
    if !look.cells.settled {
        return Finding::unsettled(Test::Unbiased, look.view);
    }
    let total = look.cells.total();
    let draws = look.count as f64;
    let mut worst = (0.0, 0);
    let mut means = DVec3::ZERO;
    for channel in 0..3 {
        let mut moments = Moments::default();
        for at in &look.samples {
            moments.add(f64::from(at.draw.weight[channel]));
        }
        // Failed samples are zeros: they scale the mean and the second moment.
        let share = look.share();
        let mean = moments.mean() * share;
        let second = (moments.variance() + moments.mean().powi(2)) * share;
        let truth = total.response[channel];
        let variance = (second - mean * mean).max(total.square[channel] - truth * truth);
        let error = (variance.max(0.0) / draws).sqrt().max(f64::MIN_POSITIVE);
        let z = ((mean - truth).abs() - QUADRATURE * truth).max(0.0) / error;
        if z > worst.0 {
            worst = (z, channel);
        }
        means[channel] = mean;
    }
    let (z, channel) = worst;
    let p = least_of(two_sided(z), 3);
    finding(Measure::Statistic { statistic: z, p }).note(format!(
        "mean weight {:.4}, integral {:.4} ({})",
        means[channel], total.response[channel], CHANNELS[channel]
    ))
}

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// [`Test::Coverage`]: the share of ∫ f cosθ where the density is 0.
#[must_use]
pub fn coverage(look: &Look) -> Finding {
    let total = look.cells.total();
    let mean = total.response.element_sum() / 3.0;
    let share = if mean > 0.0 { total.uncovered / mean } else { 0.0 };
    Finding::new(Test::Coverage, Measure::error(share, UNCOVERED))
        .warning()
        .at(look.view)
        .note(format!("{:.3} % of the response has no density", 100.0 * share))
}

/// Directional albedo by a subject's own sampler, delta components included.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Albedo {
    /// Linear RGB.
    pub mean: [f64; 3],
    /// Its standard error.
    pub error: [f64; 3],
}

/// The albedo seen in `look`, with radiance that crossed an interface counted as energy.
#[must_use]
pub fn albedo(look: &Look) -> Albedo {
    let mut moments = [Moments::default(); 3];
    let draws = look.samples.iter().map(|at| &at.draw).chain(&look.deltas);
    let energies = draws.map(|draw| draw.weight.as_dvec3() * f64::from(draw.eta).powi(2));
    let failed = look.count - look.samples.len() - look.deltas.len();
    for energy in energies.chain(std::iter::repeat_n(DVec3::ZERO, failed)) {
        for (channel, moments) in moments.iter_mut().enumerate() {
            moments.add(energy[channel]);
        }
    }
    Albedo { mean: moments.map(|m| m.mean()), error: moments.map(|m| m.standard_error()) }
}

impl Albedo {
    /// The greatest of the channels.
    #[must_use]
    pub fn greatest(&self) -> f64 {
        self.mean.into_iter().fold(0.0, f64::max)
    }
}

/// [`Test::Energy`]: whether the albedo exceeds 1 by more than chance. A failure if the subject promises
/// to conserve energy; a warning otherwise, since no fit of a measurement does.
#[must_use]
pub fn conservation(look: &Look, albedo: &Albedo, is_promised: bool) -> Finding {
    let excess = |channel: usize| {
        let error = albedo.error[channel].max(f64::MIN_POSITIVE);
        (albedo.mean[channel] - 1.0 - ROUNDING) / error
    };
    let channel = (0..3).max_by(|&a, &b| albedo.mean[a].total_cmp(&albedo.mean[b])).expect("three");
    let z = (0..3).map(excess).fold(f64::NEG_INFINITY, f64::max).clamp(-1e6, 1e6);
    let p = least_of(one_sided(z), 3);
    let finding = Finding::new(Test::Energy, Measure::Statistic { statistic: z, p }).at(look.view);
    let finding = finding.note(format!(
        "albedo {:.4} ± {:.4} ({})",
        albedo.mean[channel], albedo.error[channel], CHANNELS[channel]
    ));
    if is_promised { finding } else { finding.warning() }
}
