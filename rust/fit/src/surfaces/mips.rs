//! Mip maps that are fitted to what is seen of the finest level: GGX facets at every texel of every level, the
//! baseline of the paper (§5.2). It is the best that texture maps alone can do.

use glimt_core::Invalid;
use glimt_core::dispatch;
use glimt_core::microfacet::MIN_ALPHA;
use glimt_core::models::maps::{Facet, MAX_F0, MAX_SLOPE, Maps, Texel};
use glimt_core::simd::{Lanes, Real, Vector};
use rayon::prelude::*;

use super::dual::Dual;
use super::gated::SquareLoss;
use super::queries::{Drawing, Field, Footprints, Gaussians, Queries, Samples};
use super::training::{PARTS, Pace};
use crate::adamw::{AdamW, cosine_decay};
use crate::backprop::{BLOCK, Row, ZERO_ROW};
use crate::train::State;

/// Numbers of a texel: k_d, F₀, α and the slope.
const NUMBERS: usize = 9;

/// A row of them, padded for [`Vector::transpose`].
const ROW: usize = NUMBERS.next_multiple_of(4);

/// Lanes of a part of a block.
const L: usize = 8;

/// Numbers by which a channel has derivatives: its F₀, α, the slope, and its k_d.
const SLOPES: usize = 5;

/// The numbers of all texels of maps, from which a fit of their mips starts.
#[must_use]
pub fn start(maps: &Maps) -> Vec<f32> {
    maps.all_texels()
        .flat_map(|Texel { kd, f0, alpha, slope }| kd.into_iter().chain(f0).chain([alpha]).chain(slope))
        .collect()
}

/// The maps of numbers.
///
/// # Errors
/// [`Invalid::Parts`] if they are more or less than the layout of `maps` has.
pub fn finish(maps: &Maps, numbers: &[f32]) -> Result<Maps, Invalid> {
    let texels = numbers.as_chunks::<NUMBERS>().0.iter();
    Maps::of_levels(
        maps.layout().clone(),
        texels.map(|&[r, g, b, f, g0, b0, alpha, x, y]| Texel {
            kd: [r, g, b],
            f0: [f, g0, b0],
            alpha,
            slope: [x, y],
        }),
    )
}

/// What a thread needs.
struct Worker {
    queries: Queries,
    samples: Samples,
    targets: [Row; 3],
    taps: Vec<(usize, f32)>,
    ends: Vec<usize>,
    rows: Vec<[f32; ROW]>,
    deltas: Vec<[f32; NUMBERS]>,
    gradient: Vec<f32>,
    loss: f64,
}

/// A fit of mips that is under way.
pub struct Mips<'a> {
    maps: &'a Maps,
    pace: Pace,
    drawing: Drawing<'a>,
    workers: Vec<Worker>,
}

impl<'a> Mips<'a> {
    /// Of maps whose truth is `field`.
    #[must_use]
    pub fn new(maps: &'a Maps, field: &'a dyn Field, pace: Pace) -> Self {
        let drawing = Drawing {
            field,
            gaussians: Gaussians::new(pace.samples),
            footprints: Footprints::Training { floor: pace.floor },
            seed: pace.seed,
        };
        let worker = || Worker {
            queries: Queries::default(),
            samples: Samples::default(),
            targets: [ZERO_ROW; 3],
            taps: Vec::new(),
            ends: Vec::new(),
            rows: vec![[0.0; ROW]; BLOCK],
            deltas: vec![[0.0; NUMBERS]; BLOCK],
            gradient: vec![0.0; maps.layout().texels() * NUMBERS],
            loss: 0.0,
        };
        Mips { maps, pace, drawing, workers: (0..PARTS).map(|_| worker()).collect() }
    }

    /// Makes a step; its loss per query and channel.
    pub fn step(&mut self, state: &mut State) -> f64 {
        let Mips { maps, pace, drawing, workers } = self;
        let (first, numbers) = (state.step * pace.blocks as u64, &state.numbers[..]);
        workers.par_iter_mut().enumerate().for_each(|(part, worker)| {
            worker.gradient.fill(0.0);
            worker.loss = 0.0;
            for number in (part..pace.blocks).step_by(PARTS) {
                let number = first + number as u64;
                drawing.block(number, &mut worker.queries, &mut worker.targets, &mut worker.samples);
                worker.block(maps, pace.loss, numbers);
            }
        });
        let (sum, others) = workers.split_first_mut().expect("there are parts");
        let scale = 1.0 / (pace.blocks * BLOCK * 3) as f32;
        for (i, g) in sum.gradient.iter_mut().enumerate() {
            *g = (*g + others.iter().map(|other| other.gradient[i]).sum::<f32>()) * scale;
        }
        let loss = sum.loss + others.iter().map(|other| other.loss).sum::<f64>();
        let rate = cosine_decay(pace.rate, state.step, pace.steps);
        state.step += 1;
        let adam = AdamW { beta1: 0.9, beta2: 0.99, weight_decay: 0.0 };
        let all = 0..state.numbers.len();
        let moments = state.moments.of(all);
        adam.update(&mut state.numbers, &sum.gradient, moments, state.step, rate, |_| false);
        for texel in state.numbers.as_chunks_mut::<NUMBERS>().0 {
            limit(texel);
        }
        loss * f64::from(scale)
    }
}

/// Numbers in the ranges of a [`Texel`].
fn limit(texel: &mut [f32; NUMBERS]) {
    let [kd @ .., _, _, _, _, _, _] = texel;
    kd.iter_mut().for_each(|kd| *kd = kd.clamp(0.0, 1.0));
    texel[3..6].iter_mut().for_each(|f0| *f0 = f0.clamp(0.0, MAX_F0));
    texel[6] = texel[6].clamp(MIN_ALPHA, 1.0);
    texel[7..].iter_mut().for_each(|slope| *slope = slope.clamp(-MAX_SLOPE, MAX_SLOPE));
}

impl Worker {
    fn block(&mut self, maps: &Maps, loss: SquareLoss, numbers: &[f32]) {
        let texels = numbers.as_chunks::<NUMBERS>().0;
        self.taps.clear();
        self.ends.clear();
        for (place, row) in self.queries.places.iter().zip(&mut self.rows) {
            let (taps, mut sum) = (&mut self.taps, [0.0; ROW]);
            maps.layout().taps(place, |texel, weight| {
                taps.push((texel, weight));
                (0..NUMBERS).for_each(|k| sum[k] += weight * texels[texel][k]);
            });
            *row = sum;
            self.ends.push(self.taps.len());
        }
        let mut sum = 0.0;
        compare(loss, &self.queries, &self.targets, &self.rows, &mut self.deltas, &mut sum);
        self.loss += sum;
        let gradient = self.gradient.as_chunks_mut::<NUMBERS>().0;
        let mut start = 0;
        for (&end, delta) in self.ends.iter().zip(&self.deltas) {
            for &(texel, weight) in &self.taps[start..end] {
                (0..NUMBERS).for_each(|k| gradient[texel][k] += weight * delta[k]);
            }
            start = end;
        }
    }
}

#[inline(always)]
fn part<I: Lanes<L>>(isa: I, row: &Row, g: usize) -> Vector<I, L> {
    Vector::load(isa, &row.as_flattened().as_chunks::<L>().0[g])
}

#[inline(always)]
fn part3<I: Lanes<L>>(isa: I, rows: &[Row; 3], g: usize) -> [Vector<I, L>; 3] {
    [part(isa, &rows[0], g), part(isa, &rows[1], g), part(isa, &rows[2], g)]
}

#[inline(always)]
fn constants<F: Real>([x, y, z]: [F; 3]) -> [Dual<F, SLOPES>; 3] {
    [Dual::constant(x), Dual::constant(y), Dual::constant(z)]
}

dispatch! {
    /// The loss of a block, and its derivatives by the numbers that each query sees.
    fn compare(
        isa,
        loss: SquareLoss,
        queries: &Queries,
        targets: &[Row; 3],
        rows: &[[f32; ROW]],
        deltas: &mut [[f32; NUMBERS]],
        sum: &mut f64,
    ) {
        let mut total = Vector::<I, L>::new(isa, 0.0);
        for g in 0..BLOCK / L {
            let [numbers @ .., _, _, _]: [Vector<I, L>; ROW] = Vector::transpose(isa, &rows.as_chunks::<L>().0[g]);
            let (light, view) = (part3(isa, &queries.light, g), part3(isa, &queries.view, g));
            let truth = part3(isa, targets, g);
            let mut by = [light[0].splat(0.0); NUMBERS];
            total = total + pairs(loss, &numbers, light, view, truth, &mut by);
            for k in 0..NUMBERS {
                let row = by[k].to_array();
                for lane in 0..L {
                    deltas[g * L + lane][k] = row[lane];
                }
            }
        }
        *sum = total.to_array().iter().map(|&x| f64::from(x)).sum();
    }
}

/// The loss of pairs side by side; its derivatives to `by`.
#[inline(always)]
fn pairs<F: Real>(
    loss: SquareLoss,
    numbers: &[F; NUMBERS],
    light: [F; 3],
    view: [F; 3],
    truth: [F; 3],
    by: &mut [F; NUMBERS],
) -> F {
    let (cos, zero) = (light[2], light[0].splat(0.0));
    let mut total = zero;
    let (dual_light, dual_view) = (constants(light), constants(view));
    for c in 0..3 {
        // The facet of this channel alone: what is not its own does not change it.
        let facet = Facet::of_texel(Texel {
            kd: [Dual::variable(numbers[c], 4); 3],
            f0: [Dual::variable(numbers[3 + c], 0); 3],
            alpha: Dual::variable(numbers[6], 1),
            slope: [Dual::variable(numbers[7], 2), Dual::variable(numbers[8], 3)],
        });
        let [model, ..] = facet.eval_real(dual_light, dual_view);
        let (value, slope) = loss.value_and_slope(cos, truth[c], model.value);
        total = total + value;
        let [f0, alpha, x, y, kd] = model.slopes;
        by[c] = slope * kd;
        by[3 + c] = slope * f0;
        for (sum, part) in by[6..].iter_mut().zip([alpha, x, y]) {
            *sum = *sum + slope * part;
        }
    }
    total
}
