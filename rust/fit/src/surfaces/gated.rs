//! The objective of [`gated`](glimt_core::models::gated) surfaces: loss and derivatives of a block of queries.

use std::ops::Range;

use glimt_core::dispatch;
use glimt_core::kernels::network::Activation;
use glimt_core::models::gated::angles::{FRAME, LEAST_RADIUS, Polar, WARP, Warp, half_and_difference};
use glimt_core::models::gated::texture::{Disk, weights};
use glimt_core::models::gated::{Angles, Base, FEATURES, LATENT, WARPS};
use glimt_core::simd::math::{exp, ln, sigmoid};
use glimt_core::simd::{Lanes, Real, Vector};
use glimt_core::surface::Layout;

use super::dual::Dual;
use super::queries::Queries;
use crate::backprop::{self, BLOCK, Row, ZERO_ROW};

/// What is trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// What the network's outputs are added to.
    pub base: Base,
    /// What angular textures hold.
    pub angles: Angles,
    /// Whether shading frames are learned.
    pub frames: Learning,
    /// Whether radial warps are learned.
    pub warps: Learning,
    /// Latent codes.
    pub layout: Layout,
    /// H.
    pub half: Disk,
    /// D.
    pub difference: Disk,
    /// The network.
    pub network: backprop::Shape,
}

/// Whether a part of a model is learned or left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Learning {
    /// It is learned.
    Learned,
    /// It is left out.
    Off,
}

/// Where the parts are among the numbers.
#[derive(Clone, Debug)]
pub struct Places {
    /// `[texel][latent]`, all levels.
    pub latents: Range<usize>,
    /// `[texel][column][feature]` of H and of D.
    pub textures: [Range<usize>; 2],
    /// Weights, `[output][latent]`, and biases of the frames.
    pub frames: Range<usize>,
    /// Those of the warps.
    pub warps: Range<usize>,
    /// The network.
    pub network: Range<usize>,
}

impl Shape {
    /// The network of hidden layers of these widths.
    #[must_use]
    pub fn network(base: Base, angles: Angles, hidden: &[usize]) -> backprop::Shape {
        let outputs = match base {
            Base::None => 3,
            Base::Maps => 6,
        };
        backprop::Shape::new(angles.inputs(), hidden, outputs, Activation::HardGelu)
    }

    /// Where the parts are.
    #[must_use]
    pub fn places(&self) -> Places {
        let mut end = 0;
        let mut take = |count: usize| {
            end += count;
            end - count..end
        };
        let columns = self.angles.columns() * FEATURES;
        Places {
            latents: take(self.layout.texels() * LATENT),
            textures: [self.half, self.difference].map(|disk| take(disk.texels() * columns)),
            frames: take(FRAME * (LATENT + 1)),
            warps: take(WARPS * (LATENT + 1)),
            network: take(self.network.len()),
        }
    }

    /// How many numbers there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places().network.end
    }

    /// Multiply-adds of an evaluation beside those of the maps and of the fetch of z_s: those of the angular textures,
    /// of gating, of frames and warps, and of the network.
    #[must_use]
    pub fn multiply_adds(&self) -> usize {
        let of = |learning, count| if learning == Learning::Learned { count } else { 0 };
        let columns = self.angles.columns();
        // Four texels; with matrices each column has a factor.
        let textures = 2 * (4 * columns * FEATURES + 4 * FEATURES);
        let network: usize =
            (0..self.network.layers()).map(|l| self.network.layer(l)).map(|(i, o)| i * o).sum();
        textures + of(self.frames, FRAME * LATENT) + of(self.warps, WARPS * LATENT) + network
    }
}

/// What is minimised, per channel, with cosθ f of the truth and of the model: the square of their difference over that
/// of the model's own value and a floor (§4.4), and a share of the square alone. Squares have the mean of noisy targets
/// as their minimum, which logarithms and magnitudes have not.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SquareLoss {
    /// Added to the model's value; what is darker counts as if it were as bright.
    pub floor: f32,
    /// Weight of the square alone.
    pub absolute: f32,
}

impl SquareLoss {
    /// The loss and its derivative by the model's f.
    #[inline(always)]
    pub(super) fn value_and_slope<F: Real>(&self, cos: F, truth: F, model: F) -> (F, F) {
        let difference = cos * (model - truth);
        let scale = cos.fma(model, cos.splat(self.floor)).reciprocal();
        let weight = scale * scale + self.absolute;
        (difference * difference * weight, difference * cos * weight * 2.0)
    }
}

/// Sector and ring, and their derivatives, of a block's lookups in one texture.
struct LookUp {
    ring: Row,
    sector: Row,
    ring_by_frame: [Row; FRAME],
    sector_by_frame: [Row; FRAME],
    ring_by_warp: [Row; WARP],
    /// What each corner yields: `[query][corner][feature]`.
    corners: Vec<[[f32; FEATURES]; 4]>,
}

impl LookUp {
    fn new() -> LookUp {
        LookUp {
            ring: ZERO_ROW,
            sector: ZERO_ROW,
            ring_by_frame: [ZERO_ROW; FRAME],
            sector_by_frame: [ZERO_ROW; FRAME],
            ring_by_warp: [ZERO_ROW; WARP],
            corners: vec![[[0.0; FEATURES]; 4]; BLOCK],
        }
    }
}

/// Room for one block.
pub struct Workspace {
    /// Texels that the footprints see, query after query.
    taps: Vec<(usize, f32)>,
    /// For each query, where its taps end.
    ends: Vec<usize>,
    latents: Vec<[f32; LATENT]>,
    latents_delta: Vec<[f32; LATENT]>,
    look_ups: [LookUp; 2],
    network: backprop::Workspace,
}

impl Workspace {
    /// Room for blocks of this shape.
    #[must_use]
    pub fn new(shape: &Shape) -> Workspace {
        Workspace {
            taps: Vec::new(),
            ends: Vec::new(),
            latents: vec![[0.0; LATENT]; BLOCK],
            latents_delta: vec![[0.0; LATENT]; BLOCK],
            look_ups: [LookUp::new(), LookUp::new()],
            network: backprop::Workspace::new(&shape.network),
        }
    }
}

/// A block's truth.
pub struct Targets<'a> {
    /// f, [channel].
    pub f: &'a [Row; 3],
    /// f_a of the maps, [channel]; not looked at on [`Base::None`].
    pub analytic: &'a [Row; 3],
}

/// The loss summed over a block; adds its derivatives to `gradient`.
pub fn block(
    shape: &Shape,
    loss: SquareLoss,
    numbers: &[f32],
    queries: &Queries,
    targets: &Targets,
    workspace: &mut Workspace,
    gradient: &mut [f32],
) -> f64 {
    fetch(shape, numbers, queries, workspace);
    forward(shape, numbers, queries, workspace);
    let places = shape.places();
    let network = &numbers[places.network.clone()];
    backprop::forward(&shape.network, network, &mut workspace.network);
    let mut sum = 0.0;
    compare(shape, loss, queries, targets, &mut workspace.network, &mut sum);
    backprop::backward(
        &shape.network,
        network,
        &mut workspace.network,
        &mut gradient[places.network.clone()],
    );
    backward(shape, numbers, workspace, gradient);
    scatter(shape, workspace, gradient);
    sum
}

/// The model's outputs for a block, before they are composed: [output].
pub fn outputs<'a>(
    shape: &Shape,
    numbers: &[f32],
    queries: &Queries,
    workspace: &'a mut Workspace,
) -> &'a [Row] {
    fetch(shape, numbers, queries, workspace);
    forward(shape, numbers, queries, workspace);
    backprop::forward(&shape.network, &numbers[shape.places().network], &mut workspace.network);
    workspace.network.outputs()
}

/// z_s of every query, and of what it is made.
fn fetch(shape: &Shape, numbers: &[f32], queries: &Queries, workspace: &mut Workspace) {
    let texels = numbers[shape.places().latents].as_chunks::<LATENT>().0;
    workspace.taps.clear();
    workspace.ends.clear();
    for (place, z) in queries.places.iter().zip(&mut workspace.latents) {
        let taps = &mut workspace.taps;
        let mut sum = [0.0; LATENT];
        shape.layout.taps(place, |texel, weight| {
            taps.push((texel, weight));
            for k in 0..LATENT {
                sum[k] += weight * texels[texel][k];
            }
        });
        *z = sum;
        workspace.ends.push(workspace.taps.len());
    }
}

/// Derivatives by z_s to those of the texels.
fn scatter(shape: &Shape, workspace: &Workspace, gradient: &mut [f32]) {
    let texels = gradient[shape.places().latents].as_chunks_mut::<LATENT>().0;
    let mut start = 0;
    for (&end, delta) in workspace.ends.iter().zip(&workspace.latents_delta) {
        for &(texel, weight) in &workspace.taps[start..end] {
            for k in 0..LATENT {
                texels[texel][k] += weight * delta[k];
            }
        }
        start = end;
    }
}

/// Lanes of what is not a matrix product: derivatives by six numbers fill the registers.
const L: usize = 8;

/// Part `g` of a row.
#[inline(always)]
fn part<I: Lanes<L>>(isa: I, row: &Row, g: usize) -> Vector<I, L> {
    Vector::load(isa, &row.as_flattened().as_chunks::<L>().0[g])
}

#[inline(always)]
fn put<I: Lanes<L>>(row: &mut Row, g: usize, value: Vector<I, L>) {
    value.store(&mut row.as_flattened_mut().as_chunks_mut::<L>().0[g]);
}

/// Weights and biases of `N` outputs that are linear in z_s, times it.
#[inline(always)]
fn linear<F: Real, const N: usize>(numbers: &[f32], z: &[F; LATENT]) -> [F; N] {
    let (weight, bias) = numbers.split_at(N * LATENT);
    let mut out = [z[0]; N];
    for i in 0..N {
        let mut sum = z[0].splat(bias[i]);
        for k in 0..LATENT {
            sum = z[k].fma(z[0].splat(weight[i * LATENT + k]), sum);
        }
        out[i] = sum;
    }
    out
}

dispatch! {
    /// The network's inputs.
    fn forward(isa, shape: &Shape, numbers: &[f32], queries: &Queries, workspace: &mut Workspace) {
        let places = shape.places();
        let disks = [shape.half, shape.difference];
        for g in 0..BLOCK / L {
            let rows = workspace.latents.as_chunks::<L>().0;
            let z: [Vector<I, L>; LATENT] = Vector::transpose(isa, &rows[g]);
            let light = [part(isa, &queries.light[0], g), part(isa, &queries.light[1], g), part(isa, &queries.light[2], g)];
            let view = [part(isa, &queries.view[0], g), part(isa, &queries.view[1], g), part(isa, &queries.view[2], g)];
            coordinates(shape, &places, numbers, disks, &z, light, view, &mut workspace.look_ups, g);
        }
        let columns = shape.angles.columns();
        for t in 0..2 {
            let texture = numbers[places.textures[t].clone()].as_chunks::<FEATURES>().0;
            for query in 0..BLOCK {
                let factors = match shape.angles {
                    Angles::Matrices => &workspace.latents[query][..],
                    Angles::Vectors => &[1.0],
                };
                let look_up = &mut workspace.look_ups[t];
                let ring = look_up.ring.as_flattened()[query];
                let sector = look_up.sector.as_flattened()[query];
                let (corners, between) = disks[t].corners(ring, sector);
                let weights = weights(between);
                let mut sum = Vector::<I, FEATURES>::new(isa, 0.0);
                for corner in 0..4 {
                    let texel = &texture[corners[corner / 2][corner % 2] * columns..][..columns];
                    let mut seen = Vector::new(isa, 0.0);
                    for k in 0..columns {
                        seen = Vector::load(isa, &texel[k]).fma(Vector::new(isa, factors[k]), seen);
                    }
                    seen.store(&mut look_up.corners[query][corner]);
                    sum = seen.fma(Vector::new(isa, weights[corner / 2][corner % 2]), sum);
                }
                let sum = sum.to_array();
                for k in 0..FEATURES {
                    workspace.network.values[0][t * FEATURES + k].as_flattened_mut()[query] = sum[k];
                }
            }
        }
        if shape.angles == Angles::Vectors {
            for query in 0..BLOCK {
                for k in 0..LATENT {
                    let input = &mut workspace.network.values[0][2 * FEATURES + k];
                    input.as_flattened_mut()[query] = workspace.latents[query][k];
                }
            }
        }
    }
}

/// Where the pairs of a part of a block lie in both textures, and the derivatives of that.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn coordinates<I: Lanes<L>>(
    shape: &Shape,
    places: &Places,
    numbers: &[f32],
    disks: [Disk; 2],
    z: &[Vector<I, L>; LATENT],
    light: [Vector<I, L>; 3],
    view: [Vector<I, L>; 3],
    look_ups: &mut [LookUp; 2],
    g: usize,
) {
    type Slopes<F> = Dual<F, FRAME>;
    let zero = light[0].splat(0.0);
    let polar = match shape.frames {
        Learning::Learned => {
            let frame: [Vector<I, L>; FRAME] = linear(&numbers[places.frames.clone()], z);
            let mut duals = [Slopes::constant(zero); FRAME];
            for i in 0..FRAME {
                duals[i] = Slopes::variable(frame[i], i);
            }
            let [lx, ly, lz] = light;
            let [vx, vy, vz] = view;
            let light = [Slopes::constant(lx), Slopes::constant(ly), Slopes::constant(lz)];
            let view = [Slopes::constant(vx), Slopes::constant(vy), Slopes::constant(vz)];
            half_and_difference(Some(&duals), light, view)
        }
        Learning::Off => {
            let [half, difference] = half_and_difference(None, light, view);
            [constant(half), constant(difference)]
        }
    };
    let warps: [Vector<I, L>; WARPS] = linear(&numbers[places.warps.clone()], z);
    for t in 0..2 {
        let (radius, turn) = (polar[t].radius, polar[t].turn);
        let r = radius.value;
        let (mut warped, mut slope) = (r, r.splat(1.0));
        let mut by_warp = [zero; WARP];
        if shape.warps == Learning::Learned {
            let raw = [warps[WARP * t], warps[WARP * t + 1], warps[WARP * t + 2]];
            let warp = Warp::new(raw);
            let [a, b] = warp.exponents;
            let [p, q] = warp.powers(r);
            let share = warp.share;
            let rest = -share + 1.0;
            warped = share.fma(p, rest * q);
            let least = r.max(r.splat(LEAST_RADIUS));
            let log = ln(least);
            slope = (share * a * p + rest * b * q) / least;
            by_warp =
                [share * rest * (p - q), share * p * log * sigmoid(raw[1]), rest * q * log * sigmoid(raw[2])];
        }
        let rings = (disks[t].rings - 1) as f32;
        let [ring, sector] = disks[t].coordinates(warped, turn.value);
        let look_up = &mut look_ups[t];
        put(&mut look_up.ring, g, ring);
        put(&mut look_up.sector, g, sector);
        for i in 0..FRAME {
            put(&mut look_up.ring_by_frame[i], g, radius.slopes[i] * slope * rings);
            put(&mut look_up.sector_by_frame[i], g, turn.slopes[i] * disks[t].sectors as f32);
        }
        for i in 0..WARP {
            put(&mut look_up.ring_by_warp[i], g, by_warp[i] * rings);
        }
    }
}

#[inline(always)]
fn constant<F: Real, const N: usize>(Polar { radius, turn }: Polar<F>) -> Polar<Dual<F, N>> {
    Polar { radius: Dual::constant(radius), turn: Dual::constant(turn) }
}

dispatch! {
    /// The loss, and its derivatives by the network's outputs.
    fn compare(
        isa,
        shape: &Shape,
        loss: SquareLoss,
        queries: &Queries,
        targets: &Targets,
        network: &mut backprop::Workspace,
        sum: &mut f64,
    ) {
        let (outputs, delta) = network.outputs_and_delta();
        let mut total = Vector::<I, L>::new(isa, 0.0);
        for g in 0..BLOCK / L {
            let cos = part(isa, &queries.light[2], g);
            for c in 0..3 {
                let truth = part(isa, &targets.f[c], g);
                // Values beyond this have no place in any picture; a step there would go anywhere.
                let residual = exp(part(isa, &outputs[c], g).at_most(MOST));
                let (model, analytic, gate) = match shape.base {
                    Base::None => (residual, residual, residual),
                    Base::Maps => {
                        let analytic = part(isa, &targets.analytic[c], g);
                        let gate = sigmoid(part(isa, &outputs[3 + c], g));
                        (gate.fma(analytic, residual), analytic, gate)
                    }
                };
                let (value, slope) = loss.value_and_slope(cos, truth, model);
                total = total + value;
                put(&mut delta[c], g, slope * residual);
                if shape.base == Base::Maps {
                    put(&mut delta[3 + c], g, slope * analytic * (gate * (-gate + 1.0)));
                }
            }
        }
        *sum = total.to_array().iter().map(|&x| f64::from(x)).sum();
    }
}

/// Largest logarithm of what the network adds.
const MOST: f32 = 12.0;

dispatch! {
    /// From the derivatives by the network's inputs to those by z_s, textures, frames and warps.
    fn backward(isa, shape: &Shape, numbers: &[f32], workspace: &mut Workspace, gradient: &mut [f32]) {
        let places = shape.places();
        let disks = [shape.half, shape.difference];
        let columns = shape.angles.columns();
        let inputs = workspace.network.input_delta();
        for query in 0..BLOCK {
            let mut delta = [0.0; LATENT];
            if shape.angles == Angles::Vectors {
                for k in 0..LATENT {
                    delta[k] = inputs[2 * FEATURES + k].as_flattened()[query];
                }
            }
            for t in 0..2 {
                let mut features = [0.0; FEATURES];
                for k in 0..FEATURES {
                    features[k] = inputs[t * FEATURES + k].as_flattened()[query];
                }
                let features = Vector::<I, FEATURES>::load(isa, &features);
                let texture = numbers[places.textures[t].clone()].as_chunks::<FEATURES>().0;
                let gradient = gradient[places.textures[t].clone()].as_chunks_mut::<FEATURES>().0;
                let look_up = &mut workspace.look_ups[t];
                let ring = &mut look_up.ring.as_flattened_mut()[query];
                let sector = &mut look_up.sector.as_flattened_mut()[query];
                let (corners, [r, s]) = disks[t].corners(*ring, *sector);
                let weights = weights([r, s]);
                let mut by_weight = [0.0; 4];
                let mut sums = [Vector::<I, FEATURES>::new(isa, 0.0); LATENT];
                for corner in 0..4 {
                    let (at, weight) = (corners[corner / 2][corner % 2] * columns, weights[corner / 2][corner % 2]);
                    let seen = Vector::load(isa, &look_up.corners[query][corner]) * features;
                    by_weight[corner] = sum_of(seen.to_array());
                    let scaled = features * weight;
                    for k in 0..columns {
                        let factor = match shape.angles {
                            Angles::Matrices => workspace.latents[query][k],
                            Angles::Vectors => 1.0,
                        };
                        let own = &mut gradient[at + k];
                        scaled.fma(Vector::new(isa, factor), Vector::load(isa, own)).store(own);
                        sums[k] = Vector::load(isa, &texture[at + k]).fma(Vector::new(isa, weight), sums[k]);
                    }
                }
                if shape.angles == Angles::Matrices {
                    let mut products = [[0.0; FEATURES]; LATENT];
                    for k in 0..LATENT {
                        (sums[k] * features).store(&mut products[k]);
                    }
                    let products: [Vector<I, L>; FEATURES] = Vector::transpose(isa, &products);
                    let mut sum = products[0];
                    for k in 1..FEATURES {
                        sum = sum + products[k];
                    }
                    let sum = sum.to_array();
                    for k in 0..LATENT {
                        delta[k] += sum[k];
                    }
                }
                let [a, b, c, d] = by_weight;
                // From here on these rows hold derivatives by them.
                *ring = (1.0 - s) * (c - a) + s * (d - b);
                *sector = (1.0 - r) * (b - a) + r * (d - c);
            }
            workspace.latents_delta[query] = delta;
        }
        for g in 0..BLOCK / L {
            let z: [Vector<I, L>; LATENT] = Vector::transpose(isa, &workspace.latents.as_chunks::<L>().0[g]);
            let deltas = &mut workspace.latents_delta.as_chunks_mut::<L>().0[g];
            let mut delta: [Vector<I, L>; LATENT] = Vector::transpose(isa, deltas);
            let by_ring = [part(isa, &workspace.look_ups[0].ring, g), part(isa, &workspace.look_ups[1].ring, g)];
            let by_sector = [part(isa, &workspace.look_ups[0].sector, g), part(isa, &workspace.look_ups[1].sector, g)];
            if shape.frames == Learning::Learned {
                let mut by_frame = [by_ring[0].splat(0.0); FRAME];
                for i in 0..FRAME {
                    for t in 0..2 {
                        let look_up = &workspace.look_ups[t];
                        by_frame[i] = by_ring[t].fma(part(isa, &look_up.ring_by_frame[i], g), by_frame[i]);
                        by_frame[i] = by_sector[t].fma(part(isa, &look_up.sector_by_frame[i], g), by_frame[i]);
                    }
                }
                linear_backward(&numbers[places.frames.clone()], &z, &by_frame, &mut delta, &mut gradient[places.frames.clone()]);
            }
            if shape.warps == Learning::Learned {
                let mut by_warp = [by_ring[0]; WARPS];
                for i in 0..WARPS {
                    let look_up = &workspace.look_ups[i / WARP];
                    by_warp[i] = by_ring[i / WARP] * part(isa, &look_up.ring_by_warp[i % WARP], g);
                }
                linear_backward(&numbers[places.warps.clone()], &z, &by_warp, &mut delta, &mut gradient[places.warps.clone()]);
            }
            for k in 0..LATENT {
                let row = delta[k].to_array();
                for lane in 0..L {
                    deltas[lane][k] = row[lane];
                }
            }
        }
    }
}

/// Adds the derivatives of [`linear`] by z_s to `delta`, and by the numbers to `gradient`.
#[inline(always)]
fn linear_backward<I: Lanes<L>, const N: usize>(
    numbers: &[f32],
    z: &[Vector<I, L>; LATENT],
    by_output: &[Vector<I, L>; N],
    delta: &mut [Vector<I, L>; LATENT],
    gradient: &mut [f32],
) {
    for i in 0..N {
        for k in 0..LATENT {
            let at = i * LATENT + k;
            delta[k] = by_output[i].fma(by_output[i].splat(numbers[at]), delta[k]);
            gradient[at] += sum_of((by_output[i] * z[k]).to_array());
        }
        gradient[N * LATENT + i] += sum_of(by_output[i].to_array());
    }
}

/// Σ, as a tree.
#[inline(always)]
fn sum_of([a, b, c, d, e, f, g, h]: [f32; 8]) -> f32 {
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}
