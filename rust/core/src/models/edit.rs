//! Edits of a hybrid material that keep what its network learned, and its energy.
//!
//! The network was fitted beside one analytic part f_a(p₀) and knows no other. An edited material, with
//! p in place of p₀, therefore asks it about pairs of directions as it did when it was fitted, and
//! carries its correction over:
//!
//! f = s · exp a · (f_a(p) + ε)/(f_a(p₀) + ε) + sigmoid b · f_a(p).
//!
//! - The residual changes as the analytic part does ([`change`]): a lobe that an edit makes wider takes its
//!   residual along, and a darker k_d darkens it. ε is a dark diffuse reflectance where f_a falls, and becomes the
//!   residual itself where it rises: where the fitted analytic part reflects next to nothing, a ratio
//!   means nothing, and the residual grows by no more than the analytic part does.
//! - Where the lobe becomes wider, the narrow one that was fitted would show in it as a dimple. [`Turn`] asks the
//!   network beside that lobe instead, the farther the wider the new one is.
//! - A ratio alone conserves nothing. [`Room`] is s: the share of the residual that leaves the albedo of every
//!   view below the largest of what the material had before, what the edited analytic part has, and 1. The gated
//!   analytic part is never above the analytic part, and so there always is such a share.
//!
//! What else was tried, with pictures: docs/notes/edits.md.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use crate::brdf::{Brdf, is_lit};
use crate::directions::elevations;
use crate::microfacet::{Half, Microfacet, Terms};
use crate::sampling::lobes::{sample_cosine, sample_visible_normal, visible_normal_pdf};
use crate::simd::{Real, Spread};

/// ε where f_a falls: what the analytic part of a diffuse albedo of 5 % reflects.
pub const FLOOR: f32 = 0.05 * FRAC_1_PI;

/// The factor by which the network's `residual` ≥ 0 follows the analytic value from `fitted` to `edited`.
///
/// At most 1 + (edited + ε)/residual, and without a kink where the two are equal.
#[inline(always)]
#[must_use]
pub fn change<F: Real>(fitted: F, edited: F, residual: F) -> F {
    let growth = (edited - fitted).max(edited.splat(0.0)) / (edited + FLOOR);
    let floor = growth.fma(residual, edited.splat(FLOOR));
    (edited + floor) / (fitted + floor)
}

/// By how much of the growth of α the half vector is turned aside. Less leaves a dimple, more asks the network
/// where little of the lobe is left.
const ASIDE: f32 = 0.7;

/// Least cosine of a turned direction: what is turned below the horizon is seen as grazing.
const MIN_COS: f32 = 1e-3;

/// The turn of a pair of directions out of the lobe that was fitted: about the axis at right angles to the normal
/// and the half vector, until tan²θ_h has grown by (0.7 · growth of α)² in that azimuth.
///
/// Light and view keep their places about the half vector. A pair whose h is the normal is turned along x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn<F = f32> {
    /// What tan²θ_h grows by along x and y.
    pub(crate) growth: [F; 2],
}

impl Turn {
    /// How many numbers it is.
    pub(crate) const COUNT: usize = 2;

    /// For a lobe of roughness `fitted` that is now `edited`; `None` where it is not wider along any axis.
    #[must_use]
    pub fn new(fitted: [f32; 2], edited: [f32; 2]) -> Option<Turn> {
        // The square has no kink where an edit begins.
        let growth = [0, 1].map(|i| (ASIDE * (edited[i] - fitted[i]).max(0.0)).powi(2));
        (growth != [0.0; 2]).then_some(Turn { growth })
    }
}

impl<S: Copy> Turn<S> {
    /// The pair as the network is asked about it.
    #[inline(always)]
    #[must_use]
    pub fn apply<F: Real>(&self, light: [F; 3], view: [F; 3]) -> [[F; 3]; 2]
    where
        S: Spread<F>,
    {
        let half = Half::new(light, view);
        let (zero, one) = (light[0].splat(0.0), light[0].splat(1.0));
        let tilted = zero.lt(half.across);
        let inverse = one / Real::select(tilted, half.across, one).sqrt();
        let [x, y] = [Real::select(tilted, half.vector[0] * inverse, one), half.vector[1] * inverse];
        let growth = x * x * self.growth[0].spread(x) + y * y * self.growth[1].spread(x);
        // Sine and cosine before and after, and of the angle between.
        let [sin, cos] = [half.across.sqrt() / half.length, half.vector[2] / half.length];
        let grown = half.across + half.height * growth;
        let scale = one / (half.height + grown).sqrt();
        let [sin_grown, cos_grown] = [grown.sqrt() * scale, half.vector[2] * scale];
        let sin_turn = sin_grown * cos - cos_grown * sin;
        let cos_turn = cos_grown * cos + sin_grown * sin;
        [light, view].map(|w| {
            let along = w[0] * x + w[1] * y;
            let shift = along * (cos_turn - 1.0) + w[2] * sin_turn;
            let z = w[2] * cos_turn - along * sin_turn;
            [shift.fma(x, w[0]), shift.fma(y, w[1]), z.max(z.splat(MIN_COS))]
        })
    }
}

/// Elevations between which [`Room`] interpolates, see [`elevations`].
pub const KNOTS: usize = 24;

/// Steps between knots.
const STEPS: usize = KNOTS - 1;

/// How far above what it may have an albedo goes before the residual is limited: a material that was fitted
/// with an albedo above 1 is not held fast at the least edit, and has its own derivatives there.
const HEADROOM: f32 = 1.02;

/// Elevations that are looked at: the knots and the middles between them, where an albedo could exceed both.
const ELEVATIONS: usize = 2 * KNOTS - 1;

/// View cosine of each elevation. The first stands for the horizon itself, where nothing can be integrated.
fn cos_theta(elevation: usize) -> f32 {
    const GRAZING: f32 = 1e-3;
    elevations::cos_at(elevation as f32 / (ELEVATIONS - 1) as f32).clamp(GRAZING, 1.0)
}

/// The directional albedo at each knot's view, and the largest over the azimuths that were looked at.
pub type Albedos = [[f32; 3]; KNOTS];

/// The share of the network's residual that there is room for, between [`KNOTS`] elevations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room<F = f32> {
    pub(crate) shares: [F; KNOTS],
}

impl Room {
    /// All of the residual.
    pub const ALL: Room = Room { shares: [1.0; KNOTS] };
    /// None of it.
    pub const NONE: Room = Room { shares: [0.0; KNOTS] };

    /// Share at each knot, in [0, 1].
    #[must_use]
    pub fn shares(&self) -> &[f32; KNOTS] {
        &self.shares
    }

    /// The room for the residual of `whole`, of which `gated` has none, below the largest albedo of `allowed` and 1,
    /// with a little headroom.
    #[must_use]
    pub fn of(views: &Views, allowed: &Allowed, gated: &dyn Brdf, whole: &dyn Brdf) -> Room {
        let room_at = |(elevation, sights): (usize, &Vec<Sight>)| -> f32 {
            // Of a middle both knots.
            let ends = [elevation / 2, elevation.div_ceil(2)].map(|knot| allowed.ends.map(|ends| ends[knot]));
            let ends = ends.into_iter().flatten().fold([0.0; 3], greater);
            let mut share: f32 = 1.0;
            for sight in sights {
                // All by the same directions, so that an edit of nothing leaves room for all.
                let [before, analytic] = [sight.albedo(allowed.before), sight.albedo(allowed.analytic)];
                let [gated, whole] = [sight.albedo(gated), sight.albedo(whole)];
                for c in 0..3 {
                    let most = HEADROOM * ends[c].max(before[c]).max(analytic[c]).max(1.0);
                    if whole[c] > most {
                        share = share.min(((most - gated[c]) / (whole[c] - gated[c])).max(0.0));
                    }
                }
            }
            share
        };
        let rooms: Vec<f32> = views.of_elevations.iter().enumerate().map(room_at).collect();
        let least = |knot: usize| {
            let [from, to] = [(2 * knot).saturating_sub(1), (2 * knot + 1).min(ELEVATIONS - 1)];
            rooms[from..=to].iter().copied().fold(1.0, f32::min)
        };
        Room { shares: std::array::from_fn(least) }
    }
}

impl<S: Copy> Room<S> {
    /// s: the lesser of the shares for light and view, so that a reciprocal material stays one.
    #[inline(always)]
    #[must_use]
    pub fn share<F: Real>(&self, light: [F; 3], view: [F; 3]) -> F
    where
        S: Spread<F>,
    {
        self.at(light[2]).min(self.at(view[2]))
    }

    /// The share for one direction: a sum of ramps, each of which rises by the step between two knots.
    #[inline(always)]
    fn at<F: Real>(&self, cos_theta: F) -> F
    where
        S: Spread<F>,
    {
        let place = elevations::place(cos_theta) * STEPS as f32;
        let mut share = self.shares[0].spread(place);
        for i in 0..STEPS {
            let ramp = (place - i as f32).clamped(0.0, 1.0);
            let step = self.shares[i + 1].spread(place) - self.shares[i].spread(place);
            share = ramp.fma(step, share);
        }
        share
    }
}

/// The greater of each channel.
fn greater(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| a[c].max(b[c]))
}

/// Whose albedos an edited material may reach.
pub struct Allowed<'a> {
    /// The material that was fitted; [`Black`] for a mix.
    pub before: &'a dyn Brdf,
    /// The edited analytic part.
    pub analytic: &'a dyn Brdf,
    /// The larger of the two materials of a mix.
    pub ends: Option<&'a Albedos>,
}

/// Where the numbers come from that an edit starts from.
#[derive(Clone, Debug, PartialEq)]
pub enum Origin {
    /// A fit: with its own numbers a material is what was fitted, and needs no room.
    Fit,
    /// Two other materials, with the greater albedo of the two at each knot: the network never saw these numbers.
    Mix(Box<Albedos>),
}

impl Origin {
    /// Of a mix of two materials with these albedos.
    #[must_use]
    pub fn mix(a: &Albedos, b: &Albedos) -> Origin {
        Origin::Mix(Box::new(std::array::from_fn(|knot| greater(a[knot], b[knot]))))
    }

    /// The albedos of a mix's materials.
    #[must_use]
    pub fn ends(&self) -> Option<&Albedos> {
        if let Origin::Mix(ends) = self { Some(ends) } else { None }
    }
}

/// What an edited material remembers of the one that it was made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// z₀.
    pub latent: Vec<f32>,
    /// Where p₀ and z₀ come from.
    pub origin: Origin,
}

/// z between two materials, linear.
pub(crate) fn mix_latents(a: &[f32], b: &[f32], t: f32) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a + (b - a) * t).collect()
}

/// What makes an edited hybrid differ from a fitted one with the same parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Edit {
    /// What it was made of.
    pub fitted: Fitted,
    /// p₀, beside which the network was fitted.
    pub microfacet: Microfacet,
    /// What the analytic part needs of p.
    pub terms: Terms,
    /// How the network is asked; `None` where it is asked about the very pair.
    pub turn: Option<Turn>,
    /// The share of the residual that stays.
    pub room: Room,
}

/// A surface that reflects nothing.
pub struct Black;

impl Brdf for Black {
    fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
        Vec3::ZERO
    }
}

/// Views of every elevation, with directions over which albedos are integrated.
pub struct Views {
    of_elevations: Vec<Vec<Sight>>,
}

/// One view, and light directions with their share of ∫ f cosθ.
struct Sight {
    light: Vec<Vec3>,
    view: Vec<Vec3>,
    weight: Vec<f32>,
}

/// Directions a lobe and view.
const DIRECTIONS: usize = 512;
/// Azimuths of a material that is not isotropic by construction. What is between them differs by less than
/// what the law of energy lets pass.
const AZIMUTHS: usize = 8;

impl Views {
    /// Views for materials with lobes of the roughnesses `alphas`.
    #[must_use]
    pub fn new(is_isotropic: bool, alphas: &[[f32; 2]]) -> Views {
        let (azimuths, directions) = if is_isotropic { (1, DIRECTIONS) } else { (AZIMUTHS, DIRECTIONS / 2) };
        let of_elevation = |elevation| {
            let z = cos_theta(elevation);
            let r = (1.0 - z * z).sqrt();
            let sight = |i: usize| {
                let phi = (i as f32 + 0.5) / azimuths as f32 * std::f32::consts::TAU;
                Sight::new(Vec3::new(r * phi.cos(), r * phi.sin(), z), alphas, directions)
            };
            (0..azimuths).map(sight).collect()
        };
        Views { of_elevations: (0..ELEVATIONS).map(of_elevation).collect() }
    }

    /// Albedos of `brdf` at the knots.
    #[must_use]
    pub fn albedos(&self, brdf: &dyn Brdf) -> Albedos {
        let at = |knot: usize| {
            self.of_elevations[2 * knot].iter().map(|sight| sight.albedo(brdf)).fold([0.0; 3], greater)
        };
        std::array::from_fn(at)
    }
}

impl Sight {
    /// Directions from a cosine lobe and a GGX lobe of every roughness in equal shares, weighted by the balance
    /// heuristic.
    fn new(view: Vec3, alphas: &[[f32; 2]], directions: usize) -> Sight {
        let mut sight = Sight { light: Vec::new(), view: Vec::new(), weight: Vec::new() };
        let lobes = alphas.len() + 1;
        for i in 0..directions * lobes {
            // Points of the R2 sequence (Roberts 2018), every lobe's own.
            let [u1, u2] = [0.754_877_666, 0.569_840_291]
                .map(|step: f64| (0.5 + (i / lobes) as f64 * step).fract() as f32);
            let light = match i % lobes {
                0 => sample_cosine(u1, u2),
                lobe => sample_visible_normal(alphas[lobe - 1], view, u1, u2),
            };
            if !is_lit(light, view) {
                continue;
            }
            let density = |&alpha: &[f32; 2]| visible_normal_pdf(alpha, light, view);
            let pdf = light.z * FRAC_1_PI + alphas.iter().map(density).sum::<f32>();
            sight.light.push(light);
            sight.view.push(view);
            sight.weight.push(light.z / (pdf * directions as f32));
        }
        sight
    }

    /// ∫ f cosθ.
    fn albedo(&self, brdf: &dyn Brdf) -> [f32; 3] {
        let mut f = vec![Vec3::ZERO; self.light.len()];
        brdf.eval_batch(&self.light, &self.view, &mut f);
        let sum =
            f.iter().zip(&self.weight).map(|(&f, &weight)| (f * weight).as_dvec3()).sum::<glam::DVec3>();
        sum.as_vec3().into()
    }
}

/// The same in float64. What tests compare against.
pub mod reference {
    use super::{MIN_COS, Room, STEPS, Turn};
    use glam::{DQuat, DVec2, DVec3};

    /// [`Turn::apply`], as a rotation.
    #[must_use]
    pub fn turn(turn: &Turn, light: DVec3, view: DVec3) -> (DVec3, DVec3) {
        let half = (light + view).normalize();
        let azimuth = if half.truncate() == DVec2::ZERO { DVec2::X } else { half.truncate().normalize() };
        let growth = DVec2::from_array(turn.growth.map(f64::from)).dot(azimuth * azimuth);
        let tangent = half.truncate().length() / half.z;
        let angle = (tangent * tangent + growth).sqrt().atan() - tangent.atan();
        let rotation = DQuat::from_axis_angle(azimuth.perp().extend(0.0), angle);
        let turned = |w: DVec3| {
            let w = rotation * w;
            w.with_z(w.z.max(MIN_COS.into()))
        };
        (turned(light), turned(view))
    }

    /// [`change`](super::change).
    #[must_use]
    pub fn change(fitted: f64, edited: f64, residual: f64) -> f64 {
        let floor = f64::from(super::FLOOR);
        let growth = ((edited - fitted) / (edited + floor)).max(0.0);
        (edited + floor + growth * residual) / (fitted + floor + growth * residual)
    }

    /// [`Room::share`], as an interpolation.
    #[must_use]
    pub fn share(room: &Room, cos_light: f64, cos_view: f64) -> f64 {
        let of = |cos_theta: f64| {
            let place = 0.5 * (cos_theta.sqrt() + 1.0 - (1.0 - cos_theta).sqrt()) * STEPS as f64;
            let knot = (place as usize).min(STEPS - 1);
            let [from, to] = [room.shares[knot], room.shares[knot + 1]].map(f64::from);
            from + (to - from) * (place - knot as f64).min(1.0)
        };
        of(cos_light).min(of(cos_view))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = DVec3> {
        (0.02..0.999f64, 0.0..std::f64::consts::TAU).prop_map(|(z, phi)| {
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * phi.cos(), r * phi.sin(), z)
        })
    }

    proptest! {
        #[test]
        fn turned_pairs_are_the_reference(
            light in direction(), view in direction(), alpha in (0.02..1.0f32, 0.02..1.0f32)
        ) {
            prop_assume!((light + view).truncate().length() > 1e-3);
            let Some(turn) = Turn::new([0.02; 2], [alpha.0, alpha.1]) else { return Ok(()) };
            let (l, v): ([f32; 3], [f32; 3]) = (light.as_vec3().into(), view.as_vec3().into());
            let truth = reference::turn(&turn, light, view);
            for (turned, truth) in turn.apply(l, v).into_iter().zip([truth.0, truth.1]) {
                prop_assert!(Vec3::from(turned).as_dvec3().distance(truth) < 1e-5, "{:?} {}", turned, truth);
            }
            // A reciprocal material is asked the same either way.
            let [a, b] = turn.apply(v, l);
            prop_assert_eq!([b, a], turn.apply(l, v));
        }

        #[test]
        fn shares_are_interpolated(light in 0.0..1.0f32, view in 0.0..1.0f32) {
            let room = Room { shares: std::array::from_fn(|i| ((i * 7) % 5) as f32 / 4.0) };
            let share: f32 = room.share([0.0, 0.0, light], [0.0, 0.0, view]);
            let truth = reference::share(&room, light.into(), view.into());
            prop_assert!((f64::from(share) - truth).abs() < 1e-5, "{} {}", share, truth);
        }
    }

    proptest! {
        #[test]
        fn a_residual_grows_by_no_more_than_the_analytic_part(
            fitted in 0.0..100.0f32, edited in 0.0..100.0f32, residual in 1e-3..100.0f32
        ) {
            let changed = residual * change(fitted, edited, residual);
            prop_assert!(changed <= (residual + edited + FLOOR) * 1.000_01);
            prop_assert!((changed >= residual) == (edited >= fitted) || (changed - residual).abs() < 1e-4 * residual);
            let exact = reference::change(fitted.into(), edited.into(), residual.into());
            prop_assert!((f64::from(change(fitted, edited, residual)) - exact).abs() < 1e-5 * exact);
        }
    }

    #[test]
    fn a_lobe_that_is_not_wider_is_not_turned_away_from() {
        assert_eq!(Turn::new([0.2, 0.3], [0.2, 0.3]), None);
        assert_eq!(Turn::new([0.2, 0.3], [0.1, 0.3]), None);
        assert!(Turn::new([0.2, 0.3], [0.1, 0.4]).is_some());
    }

    #[test]
    fn a_pair_about_the_normal_has_a_turn() {
        let turn = Turn::new([0.1; 2], [0.6; 2]).unwrap();
        let [light, view] = turn.apply([0.0, 0.0, 1.0f32], [0.0, 0.0, 1.0]);
        assert_eq!(light, view);
        assert!((light[0] / light[2] - ASIDE * 0.5).abs() < 1e-6 && light[1] == 0.0);
    }

    struct Lambert(f32);

    impl Brdf for Lambert {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            if is_lit(light, view) { Vec3::splat(self.0 * FRAC_1_PI) } else { Vec3::ZERO }
        }
    }

    #[test]
    fn albedos_are_integrals() {
        for is_isotropic in [true, false] {
            let albedos = Views::new(is_isotropic, &[[0.1; 2], [0.4, 0.2]]).albedos(&Lambert(0.7));
            for albedo in albedos.as_flattened() {
                assert!((albedo - 0.7).abs() < 6.5e-3, "{albedo}");
            }
        }
    }

    #[test]
    fn room_is_what_is_left_below_the_largest_of_before_analytic_ends_and_one() {
        let views = Views::new(true, &[[0.3; 2]]);
        let room = |before: f32, analytic: f32, ends: f32, gated: f32, whole: f32| {
            let (before, analytic, ends) = (Lambert(before), Lambert(analytic), [[ends; 3]; KNOTS]);
            let allowed = Allowed { before: &before, analytic: &analytic, ends: Some(&ends) };
            Room::of(&views, &allowed, &Lambert(gated), &Lambert(whole)).shares
        };
        let near = |shares: [f32; KNOTS], share: f32| shares.iter().all(|s| (s - share).abs() < 0.01);
        assert_eq!(room(0.8, 0.5, 0.0, 0.4, 0.95), Room::ALL.shares);
        assert_eq!(room(1.5, 0.5, 0.0, 0.4, 1.5), Room::ALL.shares);
        assert!(near(room(0.8, 0.5, 0.0, 0.5, 1.5), HEADROOM - 0.5));
        assert!(near(room(1.2, 0.5, 0.0, 0.5, 1.5), 1.2 * HEADROOM - 0.5));
        assert!(near(room(0.8, 1.25, 0.0, 0.5, 1.5), 1.25 * HEADROOM - 0.5));
        assert!(near(room(0.8, 0.5, 1.25, 0.5, 1.5), 1.25 * HEADROOM - 0.5));
        assert!(near(room(0.8, 0.5, 0.0, 1.02, 1.5), 0.0));
    }
}
