//! `gated`: Timonen, Kemppinen, Lehtinen, *A Real-Time Multi-Scale Neural Representation for Complex Surface
//! Reflectance*.
//!
//! A surface at a place and a footprint has a latent code z_s, fetched from a pyramid (§3). It makes a shading frame
//! (§3.1) and radial warps (§3.2), and is multiplied by matrices H and D that are looked up by half and difference
//! vector: ln f = MLP(H z_s, D z_s) (eq. 6). With [`Angles::Vectors`] it is the tripleplane model instead,
//! ln f = MLP(H, D, z_s) (eq. 5).
//!
//! On [`Base::Maps`], which the paper does not have, the network adds to and takes from the material's own texture
//! maps as the hybrid model does: f = exp a + sigmoid b · f_a, with f_a of [`crate::models::maps`]. Close up the maps
//! are right; from afar the network is. On [`Base::None`] the maps are only what the sampler follows.
//!
//! The paper's SiLU is our hard GELU here, which costs no exponential. Half vectors have no azimuth at the centre of
//! the disk, and difference vectors none where light and view are one: textures have one texel there.

pub mod angles;
pub mod texture;

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::brdf::{Sample, SampleBrdf};
use crate::error::Invalid;
use crate::kernels::Kernel;
use crate::kernels::network::{Layer, Network, Rows};
use crate::kernels::placed::{self, PlacedKernel};
use crate::models::hybrid::{Composition, check_bound};
use crate::models::maps::{Facet, Maps};
use crate::models::{Local, Model};
use crate::simd::math::exp;
use crate::simd::{Lane, Lanes, Real, Spread, Vector};
use crate::surface::{Place, Pyramid};
use angles::{FRAME, WARP, Warp, half_and_difference};
use texture::Texture;

/// Numbers of z_s, D_s of the paper.
pub const LATENT: usize = 8;

/// Numbers of z_h and of z_d. The paper has 5; eight are a register, and cost no more.
pub const FEATURES: usize = 8;

/// Most inputs of the network.
const MAX_INPUTS: usize = 2 * FEATURES + LATENT;

/// What the network's outputs are added to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Base {
    /// Nothing: three outputs, f = exp a, as the paper has it.
    None,
    /// The material's maps: six outputs, f = exp a + sigmoid b · f_a.
    Maps,
}

/// What angular textures hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Angles {
    /// Matrices, which z_s is multiplied by (eq. 6).
    Matrices,
    /// Vectors, beside which z_s is an input of the network (eq. 5).
    Vectors,
}

impl Angles {
    /// Columns of a texel of an angular texture.
    #[must_use]
    pub fn columns(self) -> usize {
        match self {
            Angles::Matrices => LATENT,
            Angles::Vectors => 1,
        }
    }

    /// Inputs of the network.
    #[must_use]
    pub fn inputs(self) -> usize {
        match self {
            Angles::Matrices => 2 * FEATURES,
            Angles::Vectors => MAX_INPUTS,
        }
    }
}

/// Numbers that are linear in z_s: `N` of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear<const N: usize> {
    /// `[output][latent]`.
    pub weight: [[f32; LATENT]; N],
    /// `[output]`.
    pub bias: [f32; N],
}

impl<const N: usize> Linear<N> {
    #[inline(always)]
    fn apply<F: Real>(&self, z: &[F; LATENT]) -> [F; N] {
        let mut out = [z[0]; N];
        for i in 0..N {
            let mut sum = z[0].splat(self.bias[i]);
            for k in 0..LATENT {
                sum = z[k].fma(z[0].splat(self.weight[i][k]), sum);
            }
            out[i] = sum;
        }
        out
    }
}

/// Numbers of both radial warps: that of the half vector, then that of the difference vector.
pub const WARPS: usize = 2 * WARP;

/// What a [`Gated`] is made of.
#[derive(Clone, Debug)]
pub struct Parts {
    /// What the network's outputs are added to.
    pub base: Base,
    /// What angular textures hold.
    pub angles: Angles,
    /// The texture maps, or what the sampler follows in place of them.
    pub maps: Maps,
    /// z_s.
    pub latents: Pyramid<LATENT>,
    /// Learned shading frames; `None` for the surface's own.
    pub frames: Option<Linear<FRAME>>,
    /// Learned radial warps; `None` for none.
    pub warps: Option<Linear<WARPS>>,
    /// H.
    pub half: Texture,
    /// D.
    pub difference: Texture,
    /// The network: [`Angles::inputs`] to three or six outputs.
    pub network: Network,
    /// Largest a that counts.
    pub bound: f32,
}

impl Parts {
    /// All numbers but those of the maps and the network, which are checked where they are made.
    fn numbers(&self) -> impl Iterator<Item = f32> {
        let frames =
            self.frames.iter().flat_map(|frames| frames.weight.as_flattened().iter().chain(&frames.bias));
        let warps = self.warps.iter().flat_map(|warps| warps.weight.as_flattened().iter().chain(&warps.bias));
        let textures = [self.half.numbers(), self.difference.numbers()];
        let textures = textures.into_iter().flat_map(<[_]>::as_flattened);
        let latents = self.latents.all_texels().as_flattened();
        frames.chain(warps).chain(textures).chain(latents).chain([&self.bound]).copied()
    }
}

/// A surface whose apparent reflectance at every scale is learned.
#[derive(Clone, Debug)]
pub struct Gated {
    parts: Arc<Parts>,
    first_bias: Arc<[Lane]>,
}

impl Gated {
    /// Of its parts.
    ///
    /// # Errors
    /// [`Invalid::Parts`] for parts that do not fit together or hold numbers that are not finite.
    pub fn new(parts: Parts) -> Result<Gated, Invalid> {
        let (inputs, outputs) = (parts.network.features(), parts.network.outputs());
        let expected = (parts.angles.inputs(), parts.base.composition().map_or(3, Composition::outputs));
        if (inputs, outputs) != expected || parts.network.latent() != 0 {
            let (needed, made) = expected;
            return Err(Invalid::Parts(format!(
                "the network makes {outputs} numbers of {inputs}, expected {made} of {needed}"
            )));
        }
        let columns = parts.angles.columns();
        for texture in [&parts.half, &parts.difference] {
            let (found, expected) = (texture.numbers().len(), texture.disk().texels() * columns);
            if found != expected {
                return Err(Invalid::Parts(format!(
                    "an angular texture has {found} columns, expected {expected}"
                )));
            }
        }
        check_bound(parts.bound)?;
        if !parts.numbers().all(|x| x.is_finite()) {
            return Err(
                "a latent code, a texture, a frame or a warp holds a number that is not finite".into()
            );
        }
        let first_bias = parts.network.fold(&[]).into();
        Ok(Gated { parts: Arc::new(parts), first_bias })
    }

    /// What it is made of.
    #[must_use]
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// What it reflects at a place.
    #[must_use]
    pub fn at(&self, place: &Place) -> Point<'_> {
        Point { model: self, latent: self.latent(place), facet: self.parts.maps.at(place) }
    }

    #[inline(always)]
    fn latent(&self, place: &Place) -> [f32; LATENT] {
        let mut z = [0.0; LATENT];
        let texels = self.parts.latents.all_texels();
        self.parts.latents.layout().taps(place, |texel, weight| {
            for k in 0..LATENT {
                z[k] += weight * texels[texel][k];
            }
        });
        z
    }
}

impl Base {
    fn composition(self) -> Option<Composition> {
        match self {
            Base::None => None,
            Base::Maps => Some(Composition::GatedResidual),
        }
    }

    /// f of one channel from the network's outputs, of which there is one less on [`Base::None`].
    #[inline(always)]
    #[must_use]
    pub fn compose<F: Real>(self, a: F, b: F, analytic: F, bound: F) -> F {
        match self {
            Base::None => exp(bound.min(a)),
            // A grazing light on an inclined facet leaves no room above it.
            Base::Maps => Composition::GatedResidual.compose(a, b, analytic, bound).at_most(f32::MAX),
        }
    }
}

/// A [`Gated`] at a place.
#[derive(Clone, Copy, Debug)]
pub struct Point<'a> {
    model: &'a Gated,
    latent: [f32; LATENT],
    facet: Facet,
}

/// f of pairs side by side, at places with these latent codes and facets.
#[inline(always)]
fn evaluate<I: Lanes<L>, const L: usize>(
    isa: I,
    model: &Gated,
    latents: &[[f32; LATENT]; L],
    facet: &Facet<impl Spread<Vector<I, L>>>,
    light: [Vector<I, L>; 3],
    view: [Vector<I, L>; 3],
) -> [Vector<I, L>; 3] {
    let parts = &*model.parts;
    let z: [Vector<I, L>; LATENT] = Vector::transpose(isa, latents);
    let frame = match &parts.frames {
        Some(frames) => Some(frames.apply(&z)),
        None => None,
    };
    let mut polar = half_and_difference(frame.as_ref(), light, view);
    if let Some(warps) = &parts.warps {
        let [a, b, c, d, e, f] = warps.apply(&z);
        polar[0].radius = Warp::new([a, b, c]).apply(polar[0].radius);
        polar[1].radius = Warp::new([d, e, f]).apply(polar[1].radius);
    }
    let mut x = [[0.0; L]; MAX_INPUTS];
    look_up(isa, parts, &parts.half, polar[0], latents, &mut x, 0);
    look_up(isa, parts, &parts.difference, polar[1], latents, &mut x, FEATURES);
    if parts.angles == Angles::Vectors {
        for k in 0..LATENT {
            z[k].store(&mut x[2 * FEATURES + k]);
        }
    }
    let mut y = Rows::default();
    parts.network.forward_tile(isa, model.first_bias.as_flattened(), &x[..parts.angles.inputs()], &mut y);
    let mut f = light;
    let bound = Vector::new(isa, parts.bound);
    match parts.base {
        Base::None => {
            for c in 0..3 {
                let a = Vector::load(isa, &y[c]);
                f[c] = parts.base.compose(a, a, a, bound);
            }
        }
        Base::Maps => {
            let analytic = facet.eval_real(light, view);
            for c in 0..3 {
                let (a, b) = (Vector::load(isa, &y[c]), Vector::load(isa, &y[3 + c]));
                f[c] = parts.base.compose(a, b, analytic[c], bound);
            }
        }
    }
    f
}

/// z_h or z_d of every lane, to the rows of `x` from `first` on.
#[inline(always)]
fn look_up<I: Lanes<L>, const L: usize>(
    isa: I,
    parts: &Parts,
    texture: &Texture,
    polar: angles::Polar<Vector<I, L>>,
    latents: &[[f32; LATENT]; L],
    x: &mut [[f32; L]; MAX_INPUTS],
    first: usize,
) {
    let [ring, sector] = texture.disk().coordinates(polar.radius, polar.turn);
    let (ring, sector) = (ring.to_array(), sector.to_array());
    for lane in 0..L {
        let factors = match parts.angles {
            Angles::Matrices => &latents[lane][..],
            Angles::Vectors => &[1.0],
        };
        let seen = texture.fetch::<I::Isa>(isa.isa(), [ring[lane], sector[lane]], factors);
        for k in 0..FEATURES {
            x[first + k][lane] = seen[k];
        }
    }
}

impl Kernel for Point<'_> {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        evaluate(isa, self.model, &[self.latent; L], &self.facet, light, view)
    }
}

impl Point<'_> {
    /// A light, with the density of [`Point::pdf`](SampleBrdf::pdf).
    pub(crate) fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        self.facet.sample_direction(view, u)
    }
}

impl SampleBrdf for Point<'_> {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        self.facet.pdf(light, view)
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        self.facet.draw(self, view, u)
    }
}

impl PlacedKernel for Gated {
    #[inline(always)]
    fn eval_placed<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        places: &[Place; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut latents = [[0.0; LATENT]; L];
        for lane in 0..L {
            latents[lane] = self.latent(&places[lane]);
        }
        evaluate(isa, self, &latents, &self.parts.maps.facets(isa, places), light, view)
    }
}

impl Kernel for Gated {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let far = [*self.parts.latents.mean(); L];
        evaluate(isa, self, &far, self.parts.maps.far(), light, view)
    }
}

impl Model for Gated {
    const KIND: &'static str = "gated";

    fn describe(&self) -> String {
        let Parts { base, angles, latents, frames, warps, half, network, .. } = self.parts();
        let [width, height] = latents.layout().size();
        let on = match base {
            Base::None => "",
            Base::Maps => " on maps",
        };
        let gate = match angles {
            Angles::Matrices => "matrices",
            Angles::Vectors => "vectors",
        };
        let learned = match (frames, warps) {
            (Some(_), Some(_)) => ", learned frames and warps",
            (Some(_), None) => ", learned frames",
            (None, Some(_)) => ", learned warps",
            (None, None) => "",
        };
        let texels = half.disk().texels();
        let sizes: Vec<String> =
            network.layers().iter().map(|layer: &Layer| layer.outputs().to_string()).collect();
        format!(
            "{width}×{height} latent codes{on}, {gate} at {texels} half vectors{learned}, network {}-{}",
            network.features(),
            sizes.join("-")
        )
    }

    fn is_isotropic(&self) -> bool {
        false
    }

    fn at(&self, place: &Place) -> Option<Local<'_>> {
        Some(Local::Gated(Gated::at(self, place)))
    }

    fn eval_packet_at(&self, places: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        placed::eval_packet(self, places, light, view, out);
    }
}

/// The same model in float64. What tests compare against.
pub mod reference {
    use std::f64::consts::{PI, TAU};

    use glam::DVec3;

    use super::angles::{LEAST_EXPONENT, WARP};
    use super::texture::Texture;
    use super::{Angles, Base, Linear, Point};
    use crate::kernels::network;
    use crate::simd::math::reference::{exp, sigmoid};

    /// f for directions above the horizon; the facet's own is `analytic`.
    #[must_use]
    pub fn eval(point: &Point, analytic: [f64; 3], light: DVec3, view: DVec3) -> [f64; 3] {
        let parts = point.model.parts();
        let z = point.latent.map(f64::from);
        let [light, view] = match &parts.frames {
            Some(frames) => {
                let numbers = linear(frames, &z);
                let normal = DVec3::from_slice(&numbers).normalize();
                let tangent = DVec3::from_slice(&numbers[3..]);
                let tangent = (tangent - normal * normal.dot(tangent)).normalize();
                let bitangent = normal.cross(tangent);
                [light, view].map(|w| {
                    let (x, y) = (w.dot(tangent), w.dot(bitangent));
                    DVec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
                })
            }
            None => [light, view],
        };
        let half = (light + view).normalize();
        let (phi, theta) = (half.y.atan2(half.x), half.truncate().length().atan2(half.z));
        let turned = glam::DMat3::from_rotation_y(-theta) * (glam::DMat3::from_rotation_z(-phi) * light);
        let warps = parts.warps.as_ref().map(|warps| linear(warps, &z));
        let warped = |radius: f64, which: usize| match &warps {
            Some(numbers) => {
                let [share, first, second] = std::array::from_fn(|i| numbers[which * WARP + i]);
                let exponent = |x: f64| f64::from(LEAST_EXPONENT) + x.exp().ln_1p();
                let share = sigmoid(share);
                share * radius.powf(exponent(first)) + (1.0 - share) * radius.powf(exponent(second))
            }
            None => radius,
        };
        let factors = match parts.angles {
            Angles::Matrices => z.to_vec(),
            Angles::Vectors => vec![1.0],
        };
        let half_radius = warped(half.truncate().length().min(1.0), 0);
        let difference_radius = warped(turned.truncate().length().min(1.0), 1);
        let mut x = fetch(&parts.half, half_radius, phi.rem_euclid(TAU) / TAU, &factors);
        let azimuth = turned.y.atan2(turned.x).rem_euclid(PI) / PI;
        x.extend(fetch(&parts.difference, difference_radius, azimuth, &factors));
        if parts.angles == Angles::Vectors {
            x.extend(z);
        }
        let y = network::reference::forward(&parts.network, &x, &[]);
        std::array::from_fn(|c| {
            let residual = exp(y[c].min(parts.bound.into()));
            match parts.base {
                Base::None => residual,
                Base::Maps => residual + sigmoid(y[3 + c]) * analytic[c],
            }
        })
    }

    fn linear<const N: usize>(linear: &Linear<N>, z: &[f64]) -> [f64; N] {
        std::array::from_fn(|i| {
            let products = linear.weight[i].iter().zip(z).map(|(&w, z)| f64::from(w) * z);
            products.sum::<f64>() + f64::from(linear.bias[i])
        })
    }

    fn fetch(texture: &Texture, radius: f64, turn: f64, factors: &[f64]) -> Vec<f64> {
        let disk = texture.disk();
        let (ring, sector) = (radius * (disk.rings - 1) as f64, turn * disk.sectors as f64);
        let inner = (ring as usize).min(disk.rings - 2);
        let texel = |ring: usize, sector: usize| {
            let at = if ring == 0 { 0 } else { 1 + (ring - 1) * disk.sectors + sector % disk.sectors };
            let columns = &texture.numbers()[at * factors.len()..][..factors.len()];
            let seen = |k: usize| columns.iter().zip(factors).map(|(c, z)| f64::from(c[k]) * z).sum::<f64>();
            std::array::from_fn::<f64, { super::FEATURES }, _>(seen)
        };
        let (r, s) = (ring - inner as f64, sector.fract());
        let [a, b, c, d] =
            [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| texel(inner + i, sector as usize + j));
        (0..super::FEATURES)
            .map(|k| (1.0 - r) * ((1.0 - s) * a[k] + s * b[k]) + r * ((1.0 - s) * c[k] + s * d[k]))
            .collect()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::brdf::Brdf;
    use crate::kernels::network::{Activation, tests::patterned as network};
    use crate::kernels::tests::assert_is_the_reference;
    use crate::models::maps::{Filter, tests::patterned as maps};
    use crate::surface::{Footprint, Layout, Wrap};
    use texture::Disk;

    fn wave(i: usize) -> f32 {
        (i as f32 * 0.754_877_7).sin()
    }

    fn texture(columns: usize, seed: usize) -> Texture {
        let disk = Disk { rings: 5, sectors: 6 };
        let number = |i: usize| std::array::from_fn(|k| wave(i * 8 + k + seed));
        Texture::new(disk, columns, (0..disk.texels() * columns).map(number).collect()).unwrap()
    }

    /// A surface without a pattern whose network takes 16 or 24 inputs.
    pub fn patterned(base: Base, network: Network) -> Gated {
        let angles = if network.features() == 16 { Angles::Matrices } else { Angles::Vectors };
        let layout = Layout::new([4, 3], Wrap::Repeat);
        let texels = (0..layout.texels()).map(|i| std::array::from_fn(|k| 0.35 + 0.2 * wave(i * 8 + k)));
        let linear = |i: usize, k: usize| 0.3 * wave(i * 8 + k + 500);
        Gated::new(Parts {
            base,
            angles,
            maps: maps(5, 4, Filter::Moments),
            latents: Pyramid::of_levels(layout.clone(), texels.collect()).unwrap(),
            frames: Some(Linear {
                weight: std::array::from_fn(|i| std::array::from_fn(|k| linear(i, k))),
                bias: [0.0, 0.0, 1.0, 1.0, 0.0, 0.0],
            }),
            warps: Some(Linear {
                weight: std::array::from_fn(|i| std::array::from_fn(|k| linear(i + 50, k))),
                bias: [0.0, -0.4, -0.4, 0.1, -0.4, 0.4],
            }),
            half: texture(angles.columns(), 0),
            difference: texture(angles.columns(), 1000),
            network,
            bound: 1.5,
        })
        .unwrap()
    }

    fn forms() -> [Gated; 4] {
        let network = |inputs, outputs| network(&[inputs, 16, 16, outputs], inputs, Activation::HardGelu);
        [
            patterned(Base::Maps, network(16, 6)),
            patterned(Base::Maps, network(24, 6)),
            patterned(Base::None, network(16, 3)),
            patterned(Base::None, network(24, 3)),
        ]
    }

    #[test]
    fn every_form_is_the_reference() {
        for model in forms() {
            for i in 0..4 {
                let place =
                    Place { uv: [0.3 * i as f32, 0.7], footprint: Footprint::Isotropic(0.1 * i as f32) };
                let point = model.at(&place);
                let truth = |light: glam::DVec3, view: glam::DVec3| {
                    let analytic = point.facet.eval(light.as_vec3(), view.as_vec3());
                    reference::eval(&point, analytic.to_array().map(f64::from), light, view)
                };
                assert_is_the_reference(&point, truth, |f| 2e-3 * f + 1e-3);
            }
        }
    }

    #[test]
    fn packets_of_places_are_what_each_place_is() {
        for model in forms() {
            let n = 13;
            let places: Vec<Place> = (0..n)
                .map(|i| Place {
                    uv: [wave(i), wave(3 * i)],
                    footprint: Footprint::Isotropic(0.02 * i as f32),
                })
                .collect();
            let direction = |i: usize| Vec3::new(0.6 * wave(i), 0.5 * wave(2 * i), 1.0).normalize();
            let side = |step: usize| -> [Vec<f32>; 3] {
                std::array::from_fn(|c| (0..n).map(|i| direction(i * step + 1)[c]).collect())
            };
            let [light, view] = [side(1), side(5)];
            let mut f: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; n]);
            Model::eval_packet_at(
                &model,
                &places,
                light.each_ref().map(|x| &x[..]),
                view.each_ref().map(|x| &x[..]),
                f.each_mut().map(|x| &mut x[..]),
            );
            for i in 0..n {
                let alone = model.at(&places[i]).eval(direction(i + 1), direction(i * 5 + 1));
                for c in 0..3 {
                    assert!((f[c][i] - alone[c]).abs() <= 1e-5 * alone.max_element(), "{i}");
                }
            }
        }
    }

    #[test]
    fn on_no_maps_light_and_view_can_change_places() {
        let [.., model] = forms();
        let point = model.at(&Place::point([0.2, 0.9]));
        let (a, b) = (Vec3::new(0.5, 0.3, 0.8).normalize(), Vec3::new(-0.6, 0.1, 0.3).normalize());
        let (f, back) = (point.eval(a, b), point.eval(b, a));
        assert!((f - back).abs().max_element() < 1e-4 * f.max_element(), "{f} {back}");
    }

    #[test]
    fn parts_that_do_not_fit_are_refused() {
        let model = patterned(Base::Maps, network(&[16, 8, 6], 16, Activation::Relu));
        let refused = |parts: Parts| Gated::new(parts).unwrap_err().to_string();
        let parts = || model.parts().clone();
        assert!(refused(Parts { base: Base::None, ..parts() }).contains("expected 3 of 16"));
        assert!(refused(Parts { angles: Angles::Vectors, ..parts() }).contains("expected 6 of 24"));
        assert!(refused(Parts { half: texture(1, 0), ..parts() }).contains("25 columns, expected 200"));
        assert!(refused(Parts { bound: f32::NAN, ..parts() }).contains("bound"));
    }
}
