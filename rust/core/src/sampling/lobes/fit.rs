//! The choice of a BRDF's lobes.
//!
//! At a view, the weight of a sample from densities p_i with shares w_i has the second moment
//! M(w) = ∫ (f cosθ)² / Σ w_i p_i, over the hemisphere and relative to the squared albedo; M − 1 is the
//! relative variance. M is convex in w, so that the best shares of given lobes are found surely. The
//! roughnesses are those of a grid that, with their best shares, cost least over all views ([`cost`]).

use std::cmp::Ordering;
use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

use super::{GGX_LOBES, KNOTS, Lobes, Shares, sample_cosine, sample_visible_normal, visible_normal_pdf};
use crate::brdf::{Brdf, is_lit};
use crate::directions::elevations::cos_at;
use crate::microfacet::MIN_ALPHA;

/// Ratio of neighbouring roughnesses to try.
const ALPHA_RATIO: f32 = 1.44;
/// What a roughness is multiplied with when it is tuned.
const TUNING: [f32; 3] = [0.83, 1.0, 1.2];
/// Least roughness to try for a material that has none of its own.
const LEAST_ALPHA: f32 = 0.003;
/// How many times each lobe is tuned.
const TUNING_ROUNDS: usize = 2;
/// Steps below a material's own roughness that are tried: a fit may narrow the lobe, too.
const STEPS_BELOW: i32 = 4;

/// Roughnesses to try for a material whose analytic part has the roughness `alpha`, or that has none: from a
/// little below it to 1. Of an anisotropic one both numbers are scaled.
#[must_use]
pub fn candidates(alpha: Option<[f32; 2]>) -> Vec<[f32; 2]> {
    let (least, steps_below) = alpha.map_or(([LEAST_ALPHA; 2], 0), |alpha| (alpha, STEPS_BELOW));
    let step = |step: i32| scaled(least, ALPHA_RATIO.powi(step));
    let mut all: Vec<_> = (-steps_below..).map(step).take_while(|&alpha| alpha != [1.0; 2]).collect();
    all.push([1.0; 2]);
    all.dedup();
    all
}

/// Directions that are drawn from the cosine lobe at each view, and from the GGX lobe of each candidate.
const COSINE_PROBES: usize = 96;
const GGX_PROBES: usize = 24;
/// The view of the first knot, in knots, where 0 would show nothing.
const FIRST_KNOT: f32 = 0.25;
/// Turns between the azimuths of the views of an anisotropic material.
const GOLDEN_SECTION: f32 = 0.618_034;
/// Roughnesses are chosen at every second view, from the normal on.
const CHOICE_STRIDE: usize = 2;
/// How much more a variance counts that is above that of the best lobe alone.
const REGRET_WEIGHT: f32 = 10.0;
/// Steps of Newton's method in the shares when roughnesses are compared, and at the end.
const COARSE_STEPS: usize = 8;
const FINE_STEPS: usize = 16;
/// Rounds over the four numbers of the quadratic model.
const QUADRATIC_SWEEPS: usize = 32;
/// Steps of Newton's method in one share.
const NEWTON_STEPS: usize = 4;
/// Relative variance that counts as none: noise of that size is not seen in an image.
const VARIANCE_FLOOR: f32 = 1e-3;
/// Least share of the cosine lobe. With it every weight is bounded by f.
pub(super) const MIN_COSINE_SHARE: f32 = 1e-3;

impl Lobes {
    /// The lobes that sample `brdf` (the mean of its channels) with least variance, of the roughnesses
    /// `candidates`. Of an isotropic material one azimuth of the view is looked at.
    ///
    /// Deterministic; around ten thousand evaluations of `brdf`.
    #[must_use]
    pub fn fit(brdf: &(impl Brdf + ?Sized), candidates: &[[f32; 2]], is_isotropic: bool) -> Lobes {
        let views: Vec<View> =
            (0..KNOTS).map(|knot| View::new(brdf, knot, candidates, is_isotropic)).collect();
        let looked_at: Vec<&View> = views.iter().rev().step_by(CHOICE_STRIDE).collect();
        let alpha = choose(&looked_at, candidates);
        let shares = std::array::from_fn(|knot| {
            let densities = alpha.map(|alpha| views[knot].densities(alpha));
            let lobes = densities.iter().map(Vec::as_slice).collect();
            Mixture::new(&views[knot], lobes, FINE_STEPS).ordered_shares()
        });
        Lobes::new(alpha, shares)
    }
}

/// The roughnesses: the best candidate to add, one after the other, and then each tuned beside the others.
fn choose(views: &[&View], candidates: &[[f32; 2]]) -> [[f32; 2]; GGX_LOBES] {
    let candidates: Vec<Ggx> = candidates.iter().map(|&alpha| Ggx::new(views, alpha)).collect();
    let alone: Vec<f32> =
        views.iter().enumerate().map(|(v, view)| view.least_variance_of_one_lobe(&candidates, v)).collect();
    let best_beside = |chosen: &[Ggx], tried: Vec<Ggx>| -> Ggx {
        let mixtures: Vec<Mixture> = views
            .iter()
            .enumerate()
            .map(|(v, view)| {
                let lobes = chosen.iter().map(|lobe| &lobe.densities[v][..]).collect();
                Mixture::new(view, lobes, COARSE_STEPS)
            })
            .collect();
        let cost = |lobe: &Ggx| -> f32 {
            let variances = mixtures.iter().zip(&lobe.densities).map(|(m, density)| m.variance_with(density));
            variances.zip(&alone).map(|(variance, &alone)| cost(variance, alone)).sum()
        };
        let best = tried.into_iter().map(|lobe| (cost(&lobe), lobe)).min_by(|(a, _), (b, _)| a.total_cmp(b));
        best.map_or_else(|| Ggx::new(views, [1.0; 2]), |(_, lobe)| lobe)
    };
    let mut chosen: Vec<Ggx> = Vec::new();
    for _ in 0..GGX_LOBES {
        chosen.push(best_beside(&chosen, candidates.clone()));
    }
    for _ in 0..TUNING_ROUNDS * GGX_LOBES {
        // The oldest first; the new one comes last, so that all take turns.
        let alpha = chosen.remove(0).alpha;
        let near = TUNING.map(|factor| Ggx::new(views, scaled(alpha, factor)));
        chosen.push(best_beside(&chosen, near.into()));
    }
    std::array::from_fn(|lobe| chosen[lobe].alpha)
}

/// α times a factor, in its range.
fn scaled(alpha: [f32; 2], factor: f32) -> [f32; 2] {
    alpha.map(|a| (a * factor).clamp(MIN_ALPHA, 1.0))
}

/// A GGX lobe, and its densities at the probes of the views.
#[derive(Clone)]
struct Ggx {
    alpha: [f32; 2],
    densities: Vec<Vec<Row>>,
}

impl Ggx {
    fn new(views: &[&View], alpha: [f32; 2]) -> Ggx {
        Ggx { alpha, densities: views.iter().map(|view| view.densities(alpha)).collect() }
    }
}

/// What a variance costs at a view where the best lobe alone has the variance `alone`. The sum over views is
/// that of the logarithms, so that every view counts alike, and weighs what is worse than one lobe more.
fn cost(variance: f32, alone: f32) -> f32 {
    let [log, log_alone] = [variance, alone].map(|variance| (variance.max(0.0) + VARIANCE_FLOOR).ln());
    let regret = log - log_alone;
    regret + REGRET_WEIGHT * regret.max(0.0)
}

/// Numbers of that many probes are added side by side.
const SIDE: usize = 4;
type Row = [f32; SIDE];

/// What a view shows of the BRDF.
struct View {
    /// Pairs of directions. The view's azimuth is not always the same.
    probes: Vec<(Vec3, Vec3)>,
    /// (f cosθ)² over the squared albedo, the density with which the direction was drawn, and their number:
    /// what Σ (this / density) makes the second moment of.
    squares: Vec<Row>,
    /// Densities of the cosine lobe.
    cosine: Vec<Row>,
}

impl View {
    /// Evaluates `brdf` at directions drawn from the cosine lobe and every GGX lobe.
    fn new(brdf: &(impl Brdf + ?Sized), knot: usize, candidates: &[[f32; 2]], is_isotropic: bool) -> View {
        let (lights, views) = draw(knot, candidates, is_isotropic);
        let mut f = vec![Vec3::ZERO; lights.len()];
        brdf.eval_batch(&lights, &views, &mut f);
        let mut view =
            View { probes: lights.into_iter().zip(views).collect(), squares: Vec::new(), cosine: Vec::new() };
        view.cosine = view.rows(|light, _| light.z * FRAC_1_PI);
        // The number of directions drawn from all lobes together, at each one.
        let mut drawn = view.rows(|light, _| COSINE_PROBES as f32 * light.z * FRAC_1_PI);
        for &alpha in candidates {
            for (drawn, density) in
                drawn.as_flattened_mut().iter_mut().zip(view.densities(alpha).as_flattened())
            {
                *drawn += GGX_PROBES as f32 * density;
            }
        }
        let drawn = drawn.as_flattened().iter().map(|&drawn| f64::from(drawn));
        let responses =
            f.iter().zip(&view.probes).map(|(f, (light, _))| f64::from(f.element_sum() / 3.0 * light.z));
        let terms: Vec<(f64, f64)> = responses.zip(drawn).collect();
        let albedo: f64 = terms.iter().map(|(response, drawn)| response / drawn).sum();
        view.squares = vec![[0.0; SIDE]; terms.len().div_ceil(SIDE)];
        if albedo > 0.0 {
            for (square, (response, drawn)) in view.squares.as_flattened_mut().iter_mut().zip(terms) {
                let relative = response / albedo;
                *square = (relative * relative / drawn) as f32;
            }
        }
        view
    }

    /// A density at every probe, and 1 beyond the last, where it divides nothing.
    fn rows(&self, density: impl Fn(Vec3, Vec3) -> f32) -> Vec<Row> {
        let mut rows = vec![[1.0; SIDE]; self.probes.len().div_ceil(SIDE)];
        for (row, &(light, view)) in rows.as_flattened_mut().iter_mut().zip(&self.probes) {
            *row = density(light, view);
        }
        rows
    }

    /// Densities of a GGX lobe.
    fn densities(&self, alpha: [f32; 2]) -> Vec<Row> {
        self.rows(|light, view| visible_normal_pdf(alpha, light, view))
    }

    /// The least relative variance of the cosine lobe and of every candidate alone, of which this is the `v`th view.
    fn least_variance_of_one_lobe(&self, candidates: &[Ggx], v: usize) -> f32 {
        let lobes = candidates.iter().map(|lobe| &lobe.densities[v]);
        let variance = |lobe: &Vec<Row>| moment(&self.squares, lobe) - 1.0;
        [&self.cosine].into_iter().chain(lobes).map(variance).fold(f32::INFINITY, f32::min)
    }
}

/// Pairs of directions at a knot, the lights drawn from each lobe in turn.
fn draw(knot: usize, candidates: &[[f32; 2]], is_isotropic: bool) -> (Vec<Vec3>, Vec<Vec3>) {
    let cos_view = cos_at((knot as f32).max(FIRST_KNOT) / (KNOTS - 1) as f32);
    let sin_view = (1.0 - cos_view * cos_view).sqrt();
    let azimuth_at = |i: usize| if is_isotropic { 0.6 } else { TAU * (i as f32 * GOLDEN_SECTION).fract() };
    let lobes = [(None, COSINE_PROBES)].into_iter();
    let lobes = lobes.chain(candidates.iter().map(|&alpha| (Some(alpha), GGX_PROBES)));
    lobes
        .enumerate()
        .flat_map(|(lobe, (alpha, count))| (0..count).map(move |i| (lobe, alpha, i)))
        .filter_map(|(lobe, alpha, i)| {
            // Points of the R2 sequence (Roberts 2018), another stretch of it for each lobe.
            let [u1, u2] = [0.754_877_7, 0.569_840_3]
                .map(|step: f32| (0.5 + (lobe * GGX_PROBES + i) as f32 * step).fract());
            let (sin_phi, cos_phi) = azimuth_at(i).sin_cos();
            let view = Vec3::new(sin_view * cos_phi, sin_view * sin_phi, cos_view);
            let light = match alpha {
                None => sample_cosine(u1, u2),
                Some(alpha) => sample_visible_normal(alpha, view, u1, u2),
            };
            is_lit(light, view).then_some((light, view))
        })
        .unzip()
}

/// Σ squares / density: the relative second moment.
fn moment(squares: &[Row], density: &[Row]) -> f32 {
    let mut sums = [0.0; SIDE];
    for (squares, density) in squares.iter().zip(density) {
        for k in 0..SIDE {
            sums[k] += squares[k] / density[k].max(f32::MIN_POSITIVE);
        }
    }
    sums.iter().sum()
}

/// Lobes at a view, and their shares.
struct Mixture<'a> {
    view: &'a View,
    /// Densities of the lobes, the cosine lobe first.
    lobes: Vec<&'a [Row]>,
    shares: Shares,
    /// Σ share · density.
    density: Vec<Row>,
}

impl<'a> Mixture<'a> {
    /// The cosine lobe and lobes of the densities `ggx`, in the shares that Newton's method finds in so many steps.
    fn new(view: &'a View, ggx: Vec<&'a [Row]>, steps: usize) -> Mixture<'a> {
        let lobes: Vec<_> = [&view.cosine[..]].into_iter().chain(ggx).collect();
        let shares = std::array::from_fn(|i| if i < lobes.len() { 1.0 / lobes.len() as f32 } else { 0.0 });
        let mut mixture = Mixture { view, lobes, shares, density: vec![[0.0; SIDE]; view.squares.len()] };
        mixture.mix();
        mixture.descend(steps);
        mixture
    }

    fn mix(&mut self) {
        for (i, density) in self.density.iter_mut().enumerate() {
            *density = [0.0; SIDE];
            for (lobe, share) in self.lobes.iter().zip(self.shares) {
                for k in 0..SIDE {
                    density[k] += share * lobe[i][k];
                }
            }
        }
    }

    /// Moves the shares to the least second moment.
    ///
    /// M(w) falls as 1/t where w grows by t. But for its scale, the best w of the sum 1 is therefore the w ≥ 0
    /// of the least M(w) + Σw, which no other condition ties: a quadratic model of it in four numbers is solved
    /// coordinate by coordinate, and a step that went too far is halved.
    fn descend(&mut self, steps: usize) {
        let (mut best, mut least, mut target) = (self.shares, f32::INFINITY, self.shares);
        for _ in 0..steps {
            let model = self.model();
            if model.moment < least {
                (best, least) = (self.shares, model.moment);
                target = model.least_from(self.shares, self.lobes.len());
            } else {
                target = std::array::from_fn(|i| 0.5 * (best[i] + target[i]));
            }
            let sum: f32 = target.iter().sum();
            // Not so where the BRDF is black at this view, and every mixture as good.
            if !(sum > 0.0 && sum.is_finite()) {
                break;
            }
            self.shares = target.map(|share| share / sum);
            self.mix();
        }
        if self.model().moment.partial_cmp(&least) != Some(Ordering::Less) {
            self.shares = best;
            self.mix();
        }
    }

    /// The second moment and its derivatives at the shares.
    fn model(&self) -> Model {
        let mut sums = [0.0; SIDE];
        let mut slopes = [[0.0; SIDE]; GGX_LOBES + 1];
        let mut curvatures = [[[0.0; SIDE]; GGX_LOBES + 1]; GGX_LOBES + 1];
        for (n, (squares, density)) in self.view.squares.iter().zip(&self.density).enumerate() {
            let mut ratios = [[0.0; SIDE]; GGX_LOBES + 1];
            let mut moment = [0.0; SIDE];
            for k in 0..SIDE {
                let inverse = 1.0 / density[k];
                moment[k] = squares[k] * inverse;
                sums[k] += moment[k];
                for (ratio, lobe) in ratios.iter_mut().zip(&self.lobes) {
                    ratio[k] = lobe[n][k] * inverse;
                }
            }
            for i in 0..self.lobes.len() {
                for k in 0..SIDE {
                    let slope = moment[k] * ratios[i][k];
                    slopes[i][k] += slope;
                    for j in 0..=i {
                        curvatures[i][j][k] += 2.0 * slope * ratios[j][k];
                    }
                }
            }
        }
        let sum = |row: Row| row.iter().sum::<f32>();
        Model {
            moment: sum(sums),
            gains: slopes.map(sum),
            curvature: std::array::from_fn(|i| std::array::from_fn(|j| sum(curvatures[i.max(j)][i.min(j)]))),
        }
    }

    /// The relative variance with the best share of one more lobe, the others keeping their proportions.
    fn variance_with(&self, lobe: &[Row]) -> f32 {
        let mut share: f32 = 0.5;
        let mut least = f32::INFINITY;
        for _ in 0..NEWTON_STEPS {
            let [moment, slope, curvature] = self.moment_along(lobe, share);
            least = least.min(moment);
            let step = slope / curvature.max(f32::MIN_POSITIVE);
            // Not so where a BRDF is as bright as float32 allows.
            if !step.is_finite() {
                break;
            }
            // Never to the ends, where the next step would see nothing of the other lobe.
            share = (share - step).clamp(0.1 * share, 0.1 * share + 0.9);
        }
        least - 1.0
    }

    /// The second moment where a lobe has a share of `share`, and its first two derivatives.
    fn moment_along(&self, lobe: &[Row], share: f32) -> [f32; 3] {
        let mut sums = [[0.0; SIDE]; 3];
        for ((squares, density), lobe) in self.view.squares.iter().zip(&self.density).zip(lobe) {
            for k in 0..SIDE {
                let change = lobe[k] - density[k];
                let inverse = 1.0 / (density[k] + share * change);
                let (moment, slope) = (squares[k] * inverse, change * inverse);
                sums[0][k] += moment;
                sums[1][k] -= moment * slope;
                sums[2][k] += 2.0 * moment * slope * slope;
            }
        }
        sums.map(|sum| sum.iter().sum())
    }

    /// The shares in the order of [`Lobes`], that of the cosine lobe not below its least.
    fn ordered_shares(&self) -> Shares {
        let [cosine, ggx @ ..] = self.shares;
        let floor = cosine.max(MIN_COSINE_SHARE);
        let scale = (1.0 - floor) / ggx.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        let mut shares = [floor; GGX_LOBES + 1];
        for (share, fitted) in shares.iter_mut().zip(ggx) {
            *share = fitted * scale;
        }
        shares
    }
}

/// The second moment near some shares.
struct Model {
    moment: f32,
    /// What it loses with each share: ∫ (f cosθ)² p / density².
    gains: Shares,
    curvature: [Shares; GGX_LOBES + 1],
}

impl Model {
    /// The shares of the first `lobes` lobes, but for scale, at which the quadratic model is least.
    fn least_from(&self, shares: Shares, lobes: usize) -> Shares {
        let mut moved = shares;
        for _ in 0..QUADRATIC_SWEEPS {
            for i in 0..lobes {
                let slope: f32 = (0..lobes).map(|j| self.curvature[i][j] * (moved[j] - shares[j])).sum();
                let step =
                    (self.moment - self.gains[i] + slope) / self.curvature[i][i].max(f32::MIN_POSITIVE);
                moved[i] = (moved[i] - step).max(0.0);
            }
        }
        moved
    }
}
