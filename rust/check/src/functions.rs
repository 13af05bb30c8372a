//! Every function of the core against float64 over the range that it is used on, beside the condition
//! of what it computes. A budget is the largest error that a function may be blamed for.

use glam::{DVec3, Vec3};
use glimt_core::directions::features::{self, Inputs, MAX_FEATURES};
use glimt_core::microfacet::{self, ETA_RANGE, Half, MIN_ALPHA, Microfacet, Roughness};
use glimt_core::models::hybrid::Composition;
use glimt_core::sampling::lobes::{self, GGX_LOBES, KNOTS, Lobes};
use glimt_core::simd::math::{self, EXP_MAX, EXP_MIN};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::accuracy::{Worst, condition};
use crate::random_pairs::{directions, log_uniform};

/// A function of the core.
pub struct Function {
    /// Its path in the core.
    pub name: &'static str,
    /// What it is measured on.
    pub range: &'static str,
    /// Largest [`blame`](crate::accuracy::Comparison::blame) that it is allowed: error over condition.
    pub budget: f64,
    /// What its error is measured in.
    pub unit: Unit,
    /// Compares it with float64 at one random point of the range.
    compare: fn(&mut Pcg64Mcg, Unit, &mut Worst),
}

/// What counts as one ULP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// That of the exact result.
    Result,
    /// That of 1: the result is an input of a network, or a vector's component, beside others of size 1.
    One,
}

impl Unit {
    fn scale(self, exact: f64) -> f64 {
        match self {
            Unit::Result => exact,
            Unit::One => 1.0,
        }
    }
}

impl Function {
    /// The worst of `count` random points; the same for every run.
    #[must_use]
    pub fn measure(&self, count: usize) -> Worst {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut worst = Worst::default();
        for _ in 0..count {
            (self.compare)(&mut rng, self.unit, &mut worst);
        }
        worst
    }
}

const PAIRS: &str = "pairs: cosθ 1e-37..1, mirror, light = view";

/// All functions, in reading order.
pub const FUNCTIONS: &[Function] = &[
    Function {
        name: "math::exp",
        range: "-87.3..88.3",
        budget: 2.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let x = rng.random_range(EXP_MIN..EXP_MAX);
            scalar(worst, unit, [x], math::exp(x), |[x]| x.exp());
        },
    },
    Function {
        name: "math::ln",
        range: "1.2e-38..3.4e38",
        budget: 2.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let x = log_uniform(rng, f32::MIN_POSITIVE, 3e38);
            scalar(worst, unit, [x], math::ln(x), |[x]| x.ln());
        },
    },
    Function {
        name: "math::sigmoid",
        range: "-87..88",
        budget: 3.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let x = rng.random_range(-87.0..88.0);
            scalar(worst, unit, [x], math::sigmoid(x), |[x]| 1.0 / (1.0 + (-x).exp()));
        },
    },
    Function {
        name: "microfacet::fresnel",
        range: "cos 1e-30..1, η 1..10 and 1+1e-7",
        budget: 16.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let inputs = [log_uniform(rng, 1e-30, 1.0), index(rng)];
            let f = microfacet::fresnel(inputs[0], inputs[1]);
            scalar(worst, unit, inputs, f, |[cos, eta]| microfacet::reference::fresnel(cos, eta.max(1.0)));
        },
    },
    Function {
        name: "microfacet::masking_denominator",
        range: "cosθ 1e-37..1, α 1e-4..1",
        budget: 3.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let (v, _) = directions(rng);
            let alpha = roughness(rng);
            let value = microfacet::masking_denominator(v.to_array(), alpha);
            scalar(worst, unit, v.to_array(), value, |v| {
                2.0 * v[2] / microfacet::reference::g1(v, alpha.map(f64::from))
            });
        },
    },
    Function {
        name: "Half::ndf",
        range: PAIRS,
        budget: 12.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let ((l, v), p) = (directions(rng), parameters(rng));
            pair(
                worst,
                unit,
                l,
                v,
                Half::new(l.to_array(), v.to_array()).ndf(&Roughness::new(p.alpha)),
                |l, v| microfacet::reference::ndf((l + v).normalize().into(), p.alpha.map(f64::from)),
            );
        },
    },
    Function {
        name: "Half::cos_d",
        range: PAIRS,
        budget: 2.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let (l, v) = directions(rng);
            pair(worst, unit, l, v, Half::new(l.to_array(), v.to_array()).cos_d(), |l, v| {
                (0.5 * (l + v).length()).min(1.0)
            });
        },
    },
    Function {
        name: "Microfacet::eval",
        range: PAIRS,
        budget: 10.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let ((l, v), p) = (directions(rng), parameters(rng));
            pair(worst, unit, l, v, p.eval(l.to_array(), v.to_array())[0], |l, v| {
                microfacet::reference::eval(&p, l.into(), v.into())[0]
            });
        },
    },
    feature("features, (1 - cosθ_h)^¼", |rng, unit, worst| {
        feature_of(rng, unit, worst, Inputs::Isotropic, 0)
    }),
    feature("features, cosθ_d", |rng, unit, worst| feature_of(rng, unit, worst, Inputs::Isotropic, 1)),
    feature("features, cos φ_d", |rng, unit, worst| feature_of(rng, unit, worst, Inputs::Isotropic, 2)),
    feature("features, ln(1 + tan²θ_h/α²)", |rng, unit, worst| {
        feature_of(rng, unit, worst, Inputs::Isotropic, 5)
    }),
    feature("features, cos 2φ_d", |rng, unit, worst| {
        feature_of(rng, unit, worst, Inputs::IsotropicReciprocal, 2)
    }),
    feature("features, product of cosines", |rng, unit, worst| {
        feature_of(rng, unit, worst, Inputs::IsotropicReciprocal, 4)
    }),
    feature("features, azimuth of h", |rng, unit, worst| {
        feature_of(rng, unit, worst, Inputs::Anisotropic, 1)
    }),
    feature("features, sin φ_d", |rng, unit, worst| feature_of(rng, unit, worst, Inputs::Anisotropic, 4)),
    feature("features, sin 2φ_d", |rng, unit, worst| {
        feature_of(rng, unit, worst, Inputs::AnisotropicReciprocal, 4)
    }),
    Function {
        name: "Lobes::pdf",
        range: PAIRS,
        budget: 10.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            let ((l, v), lobes) = (directions(rng), sampler(rng));
            pair(worst, unit, l, v, lobes.pdf(l, v), |l, v| lobes::reference::pdf(&lobes, l, v));
        },
    },
    Function {
        name: "Lobes::sample_direction, xyz",
        range: "cosθ 1e-37..1, u in [0, 1)³",
        budget: 16.0,
        unit: Unit::One,
        compare: |rng, unit, worst| sampled(rng, unit, worst, &[0, 1, 2]),
    },
    Function {
        name: "Lobes::sample_direction, cosθ",
        range: "cosθ 1e-37..1, u in [0, 1)³",
        budget: 400.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| sampled(rng, unit, worst, &[2]),
    },
    Function {
        name: "Composition::GatedResidual",
        range: "a, b -80..20, f_a 1e-8..1e15",
        budget: 4.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            composed(rng, unit, worst, Composition::GatedResidual, |[a, b, f]| {
                a.exp() + f / (1.0 + (-b).exp())
            });
        },
    },
    Function {
        name: "Composition::LogMultiplicative",
        range: "a -80..20, f_a 1e-8..1e15",
        budget: 3.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            composed(rng, unit, worst, Composition::LogMultiplicative, |[a, _, f]| f * a.exp());
        },
    },
    Function {
        name: "Composition::Additive",
        range: "a -80..20, f_a 1e-8..1e15",
        budget: 1.0,
        unit: Unit::Result,
        compare: |rng, unit, worst| {
            composed(rng, unit, worst, Composition::Additive, |[a, _, f]| (f + a).max(0.0));
        },
    },
];

/// A feature of a network, which is blamed in ULP of 1.
const fn feature(name: &'static str, compare: fn(&mut Pcg64Mcg, Unit, &mut Worst)) -> Function {
    Function { name, range: PAIRS, budget: 8.0, unit: Unit::One, compare }
}

/// Compares a function of numbers.
fn scalar<const N: usize>(
    worst: &mut Worst,
    unit: Unit,
    inputs: [f32; N],
    computed: f32,
    exact: impl Fn([f64; N]) -> f64,
) {
    let truth = exact(inputs.map(f64::from));
    let inputs_text = || format!("{inputs:?}");
    worst.add(computed, truth, unit.scale(truth), || condition(inputs, &exact), inputs_text);
}

/// Compares a function of two directions.
fn pair(
    worst: &mut Worst,
    unit: Unit,
    light: Vec3,
    view: Vec3,
    computed: f32,
    exact: impl Fn(DVec3, DVec3) -> f64,
) {
    let inputs = [light.x, light.y, light.z, view.x, view.y, view.z];
    scalar(worst, unit, inputs, computed, |[a, b, c, x, y, z]| exact([a, b, c].into(), [x, y, z].into()));
}

fn feature_of(rng: &mut Pcg64Mcg, unit: Unit, worst: &mut Worst, inputs: Inputs, index: usize) {
    let ((l, v), alpha) = (directions(rng), roughness(rng));
    let computed: [f32; MAX_FEATURES] = inputs.compute(l.to_array(), v.to_array(), alpha);
    pair(worst, unit, l, v, computed[index], |l, v| {
        features::reference::compute(inputs, l, v, alpha.map(f64::from))[index]
    });
}

/// Compares components of a sampled direction.
fn sampled(rng: &mut Pcg64Mcg, unit: Unit, worst: &mut Worst, components: &[usize]) {
    let ((_, v), lobes) = (directions(rng), sampler(rng));
    let u = Vec3::new(rng.random(), rng.random(), rng.random());
    let Some((light, _)) = lobes.sample_direction(v, u) else { return };
    let Some(lobe) = chosen(&lobes, v, u.x) else { return };
    for &i in components {
        let inputs = [v.x, v.y, v.z, u.y, u.z];
        scalar(worst, unit, inputs, light[i], |[x, y, z, u1, u2]| {
            lobes::reference::sample_direction(&lobes, lobe, [x, y, z].into(), [u1, u2])[i]
        });
    }
}

fn composed(
    rng: &mut Pcg64Mcg,
    unit: Unit,
    worst: &mut Worst,
    composition: Composition,
    exact: impl Fn([f64; 3]) -> f64,
) {
    let (a, b) = (rng.random_range(-80.0..20.0), rng.random_range(-80.0..20.0));
    let analytic = log_uniform(rng, 1e-8, 1e15);
    scalar(worst, unit, [a, b, analytic], composition.compose(a, b, analytic, 20.0), exact);
}

/// α_x and α_y, equal half of the time.
fn roughness(rng: &mut Pcg64Mcg) -> [f32; 2] {
    let alpha = log_uniform(rng, MIN_ALPHA, 1.0);
    if rng.random() { [alpha; 2] } else { [alpha, log_uniform(rng, MIN_ALPHA, 1.0)] }
}

/// η, as often near 1 as not.
fn index(rng: &mut Pcg64Mcg) -> f32 {
    1.0 + log_uniform(rng, f32::EPSILON, ETA_RANGE[1] - 1.0)
}

fn parameters(rng: &mut Pcg64Mcg) -> Microfacet {
    // Half of the materials have no diffuse part that would hide the lobe's error.
    let kd = if rng.random() { rng.random() } else { 0.0 };
    Microfacet { kd: [kd; 3], eta: [index(rng); 3], alpha: roughness(rng) }
}

fn sampler(rng: &mut Pcg64Mcg) -> Lobes {
    let alpha = [(); GGX_LOBES].map(|()| roughness(rng));
    let shares = [(); KNOTS].map(|()| {
        let parts = [(); GGX_LOBES + 1].map(|()| rng.random_range(0.01..1.0_f32));
        parts.map(|part| part / parts.iter().sum::<f32>())
    });
    Lobes::new(alpha, shares)
}

/// The lobe that `u` selects; `None` where it is so near to an edge that rounding decides.
fn chosen(lobes: &Lobes, view: Vec3, u: f32) -> Option<usize> {
    let mut edge = 0.0;
    for (lobe, share) in lobes::reference::shares(lobes, view.z.into()).into_iter().enumerate() {
        edge += share;
        if (f64::from(u) - edge).abs() < 1e-6 {
            return None;
        }
        if f64::from(u) < edge {
            return Some(lobe);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_function_keeps_its_budget() {
        let over: Vec<String> = FUNCTIONS
            .iter()
            .map(|function| (function, function.measure(20_000).blamed))
            .filter(|(function, blamed)| blamed.blame() > function.budget)
            .map(|(function, blamed)| {
                format!("{}: {:.2} times the condition: {blamed}", function.name, blamed.blame())
            })
            .collect();
        assert!(over.is_empty(), "{}", over.join("\n"));
    }
}
