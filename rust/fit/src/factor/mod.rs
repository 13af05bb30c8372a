//! Fitting `factor`: Bagher, Snyder, Nowrouzezahrai 2016, *A Non-Parametric Factor Microfacet Model for
//! Isotropic BRDFs*, §4.
//!
//! No gradients: every factor is linear in the objective while the others are held, so that its weighted
//! least squares have a closed form, and the factors take turns. Each colour channel is fitted by itself.

mod anderson;
#[cfg(test)]
mod condition;
mod descent;
#[cfg(test)]
#[path = "../../examples/stiff/eigen.rs"]
mod eigen;
mod grid;
mod masking;
mod naive;
mod product;

use glimt_core::Brdf;
use glimt_core::models::factor::{
    AZIMUTH_BINS, DIFF_BINS, Factor, Factors, HALF_BINS, Interpolation, Product, Variant,
};
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use descent::{CONSTANT_AZIMUTH, CONSTANT_MASKING, Descent, Patience};
use grid::Resampled;
use masking::{Folded, Masking};
use naive::Whole;
use product::{STRIDE, State};

/// What to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FactorOptions {
    /// The factors.
    pub variant: Variant,
    /// How the material answers between the bins.
    pub interpolation: Interpolation,
    /// Seed of the random starts of independent G.
    pub seed: u64,
}

/// A fit and how it went.
#[derive(Clone, Debug)]
pub struct FactorFit {
    /// The material.
    pub factor: Factor,
    /// The objective (eq. 7) of each colour channel after every accepted step of the last descent.
    pub traces: [Vec<f64>; 3],
    /// Objectives of all starts where the best was chosen, by channel: over every third φ_d for the eight of
    /// independent G; the others have one start.
    pub starts: [Vec<f64>; 3],
    /// Steps of the last descent that needed golden-section search, by channel.
    pub golden_sections: [usize; 3],
}

/// Fits factors to `brdf`, resampled to the grid of the MERL database: as if it were isotropic and
/// reciprocal.
///
/// # Panics
/// Never for a `brdf` that keeps the contract of [`Brdf`]; values that are not finite count as 0.
#[must_use]
pub fn fit_factor(brdf: &dyn Brdf, options: &FactorOptions) -> FactorFit {
    let Resampled { values, trust } = grid::resample(brdf);
    let channel = |values: Vec<f32>| Channel { weights: grid::weights(&values, &trust), values };
    let channels: Vec<Channel> = values.into_par_iter().map(channel).collect();
    match options.variant {
        Variant::IndependentG => {
            let fits = independent_g(&channels, options.seed);
            let masking = std::array::from_fn(|c| to_f32(&fits[c].best.third));
            finish(&fits, |product| Factors::IndependentG { product, masking }, options)
        }
        Variant::GFromD => {
            let fit = |c: &Channel| Fits::one(c.g_from_d(&c.folded()));
            let fits: Vec<_> = channels.par_iter().map(fit).collect();
            finish(&fits, Factors::GFromD, options)
        }
        Variant::Naive => {
            let fits: Vec<_> = channels.par_iter().map(|c| Fits::one(c.naive())).collect();
            let azimuth = std::array::from_fn(|c| to_f32(&fits[c].best.third));
            finish(&fits, |product| Factors::Naive { product, azimuth }, options)
        }
        Variant::Bivariate => bivariate(&channels, options.interpolation),
    }
}

/// When the starts of independent G are compared, on a third of the samples, and when the best ends.
const FIRST: Patience = Patience { tolerance: 1e-5, steps: 120 };
const LAST: Patience = Patience { tolerance: 1e-6, steps: 300 };

/// One colour channel's samples on the whole grid.
struct Channel {
    values: Vec<f32>,
    weights: Vec<f32>,
}

/// The best descent of several starts, and the objectives of all.
struct Fits<Third> {
    best: Descent<Third>,
    objectives: Vec<f64>,
}

impl<Third> Fits<Third> {
    fn one(descent: Descent<Third>) -> Fits<Third> {
        Fits { objectives: vec![descent.objective()], best: descent }
    }
}

impl Channel {
    fn folded(&self) -> Folded {
        Folded::fine(&self.values, &self.weights)
    }

    /// D and F of the slices at θ_d = 0 and θ_h = 0, means over φ_d.
    fn slices(&self) -> State {
        let mean = |half: usize, diff: usize| {
            let at = (half * DIFF_BINS + diff) * AZIMUTH_BINS;
            let row = at..at + AZIMUTH_BINS;
            let weight: f64 = self.weights[row.clone()].iter().map(|&w| f64::from(w)).sum();
            let pairs = self.values[row.clone()].iter().zip(&self.weights[row]);
            let sum: f64 = pairs.map(|(&z, &w)| f64::from(z) * f64::from(w)).sum();
            if weight > 0.0 { sum / weight } else { 0.0 }
        };
        let mut state = State::constant();
        state.ndf = std::array::from_fn(|half| mean(half, 0));
        for (diff, fresnel) in state.fresnel[..DIFF_BINS].iter_mut().enumerate() {
            *fresnel = mean(0, diff);
        }
        state.normalized()
    }

    fn g_from_d(&self, folded: &Folded) -> Descent<Masking> {
        descent::g_from_d(folded, self.slices(), LAST)
    }

    fn naive(&self) -> Descent<naive::Azimuth> {
        descent::naive(&Whole::new(&self.values, &self.weights), self.slices(), CONSTANT_AZIMUTH, LAST)
    }
}

impl State {
    fn constant() -> State {
        let mut fresnel = [0.0; STRIDE];
        fresnel[..DIFF_BINS].fill(1.0);
        State { diffuse: 0.0, specular: 1.0, ndf: [1.0; HALF_BINS], fresnel }
    }

    fn random(rng: &mut Pcg64) -> State {
        let mut state = State::constant();
        state.ndf = std::array::from_fn(|_| rng.random());
        for fresnel in &mut state.fresnel[..DIFF_BINS] {
            *fresnel = rng.random();
        }
        state.normalized()
    }

    fn normalized(mut self) -> State {
        product::Floor::DYNAMIC_RANGE.normalize(&mut self.ndf);
        product::Floor::DYNAMIC_RANGE.normalize(&mut self.fresnel[..DIFF_BINS]);
        self
    }
}

/// Eight starts a channel (the paper, §5): the fit of G from D, ones, the slices, an analytic model, and
/// four at random.
fn independent_g(channels: &[Channel], seed: u64) -> Vec<Fits<Masking>> {
    let folded: Vec<[Folded; 2]> =
        channels.par_iter().map(|c| [Folded::coarse(&c.values, &c.weights), c.folded()]).collect();
    let starts = |c: usize| -> Vec<(State, Masking)> {
        let mut starts = vec![
            (State::constant(), CONSTANT_MASKING),
            (channels[c].slices(), CONSTANT_MASKING),
            analytic_start(&channels[c].slices()),
        ];
        for i in 0..4 {
            let mut rng = Pcg64::new(seed.into(), (4 * c + i) as u128);
            let state = State::random(&mut rng);
            starts.push((state, std::array::from_fn(|_| rng.random())));
        }
        starts
    };
    let jobs: Vec<(usize, Option<(State, Masking)>)> = (0..3)
        .map(|c| (c, None))
        .chain((0..3).flat_map(|c| starts(c).into_iter().map(move |s| (c, Some(s)))))
        .collect();
    let firsts: Vec<(usize, Descent<Masking>)> = jobs
        .into_par_iter()
        .map(|(c, start)| {
            let (state, masking) = start.unwrap_or_else(|| {
                let descent = channels[c].g_from_d(&folded[c][0]);
                (descent.state, descent.third)
            });
            (c, descent::independent_g(&folded[c][0], state, masking, FIRST))
        })
        .collect();
    (0..3)
        .into_par_iter()
        .map(|c| {
            let of_channel: Vec<&Descent<Masking>> =
                firsts.iter().filter(|f| f.0 == c).map(|f| &f.1).collect();
            let objectives = of_channel.iter().map(|descent| descent.objective()).collect();
            let best =
                of_channel.into_iter().min_by(|a, b| a.objective().total_cmp(&b.objective())).expect("eight");
            let best = descent::independent_g(&folded[c][1], best.state.clone(), best.third, LAST);
            Fits { best, objectives }
        })
        .collect()
}

/// GGX as wide as the retro-reflective slice, Schlick's Fresnel factor of glass, and Smith's G. It stands in
/// the place of Bagher et al. 2012, whose fit is a program of its own.
fn analytic_start(slices: &State) -> (State, Masking) {
    let mut state = State::constant();
    let half_width = slices.ndf.iter().position(|&d| d < 0.5).unwrap_or(HALF_BINS - 1);
    // GGX falls to one half where tan²θ = 0.41 α².
    let alpha = (grid::theta_half(half_width).tan() / 0.64).clamp(0.002, 1.0);
    state.ndf = std::array::from_fn(|half| {
        let cos = grid::theta_half(half).cos();
        (cos * cos * (alpha * alpha - 1.0) + 1.0).powi(-2)
    });
    for (diff, fresnel) in state.fresnel[..DIFF_BINS].iter_mut().enumerate() {
        *fresnel = 0.04 + 0.96 * (1.0 - grid::theta_diff(diff).cos()).powi(5);
    }
    let state = state.normalized();
    let masking = glimt_core::models::factor::smith::masking_of(&state.ndf);
    (state, masking)
}

fn to_f32<const N: usize>(factor: &[f64; N]) -> [f32; N] {
    factor.map(|x| x as f32)
}

fn finish<Third>(
    fits: &[Fits<Third>],
    factors: impl FnOnce(Product) -> Factors,
    options: &FactorOptions,
) -> FactorFit {
    let state = |c: usize| &fits[c].best.state;
    let product = Product {
        diffuse: std::array::from_fn(|c| state(c).diffuse as f32),
        specular: std::array::from_fn(|c| state(c).specular as f32),
        ndf: std::array::from_fn(|c| to_f32(&state(c).ndf)),
        fresnel: std::array::from_fn(|c| std::array::from_fn(|i| state(c).fresnel[i] as f32)),
    };
    FactorFit {
        factor: Factor::new(factors(product), options.interpolation).expect("factors are normalised"),
        traces: std::array::from_fn(|c| fits[c].best.trace.clone()),
        starts: std::array::from_fn(|c| fits[c].objectives.clone()),
        golden_sections: std::array::from_fn(|c| fits[c].best.golden_sections),
    }
}

/// The weighted mean over φ_d of every θ_h and θ_d (eq. 14). A bin without samples takes the value of the one
/// before it in θ_d, and the first ones that of θ_h before.
fn bivariate(channels: &[Channel], interpolation: Interpolation) -> FactorFit {
    let mut table = vec![[0.0; 3]; HALF_BINS * DIFF_BINS];
    let mut objectives = [0.0; 3];
    for (c, Channel { values, weights }) in channels.iter().enumerate() {
        for row in 0..HALF_BINS * DIFF_BINS {
            let samples = row * AZIMUTH_BINS..(row + 1) * AZIMUTH_BINS;
            let (mut weight, mut sum, mut square) = (0.0, 0.0, 0.0);
            for (&z, &w) in values[samples.clone()].iter().zip(&weights[samples]) {
                let (z, w) = (f64::from(z), f64::from(w));
                weight += w;
                sum += w * z;
                square += w * z * z;
            }
            table[row][c] = if weight > 0.0 {
                objectives[c] += square - sum * sum / weight;
                (sum / weight) as f32
            } else {
                let before =
                    if row % DIFF_BINS > 0 { row.checked_sub(1) } else { row.checked_sub(DIFF_BINS) };
                before.map_or(0.0, |before| table[before][c])
            };
        }
    }
    FactorFit {
        factor: Factor::new(Factors::Bivariate(table), interpolation).expect("means of finite numbers"),
        traces: objectives.map(|objective| vec![objective]),
        starts: objectives.map(|objective| vec![objective]),
        golden_sections: [0; 3],
    }
}
