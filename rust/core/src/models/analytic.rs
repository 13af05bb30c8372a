//! `analytic`: models of other papers with the parameters that these published, to compare with.
//!
//! f = k_d/π plus one specular lobe, per colour channel. Isotropic and reciprocal. The formulas are
//! evaluated in float64 as they are printed: a published exponent of 50,000 or a slope of 200,000 leaves
//! nothing of float32, and what one compares with has no use for speed.
//!
//! The parameters that are published for the MERL database follow no single normalisation. Which one
//! belongs to a model here was decided by the fits themselves: with the factors below, their specular parts are
//! as bright as their materials (`docs/guide/models.md`).

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::brdf::{Brdf, is_lit};
use crate::error::Invalid;
use crate::models::{Model, spelled};

/// Largest f: parameters may be anything, f is finite.
const MAX_F: f64 = 1e12;

/// Three numbers, by colour channel.
pub type Rgb = [f64; 3];

/// The parameters of a material.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Diffuse albedo k_d.
    pub diffuse: Rgb,
    /// The specular lobe.
    pub specular: Specular,
}

/// A specular lobe and its parameters. h is the half vector.
#[derive(Clone, Debug, PartialEq)]
pub enum Specular {
    /// Cook & Torrance 1982 as Ngan, Durand, Matusik 2005 fitted it: k_s F D G/(π cosθ_l cosθ_v), with
    /// Schlick's F, Beckmann's D = exp(−tan²θ_h/m²)/(π m² cos⁴θ_h), and the G of V-shaped grooves.
    CookTorrance {
        /// k_s.
        scale: Rgb,
        /// F at normal incidence.
        reflectance: f64,
        /// m.
        roughness: f64,
    },
    /// Ward 1992: k_s exp(−tan²θ_h/α²)/(4π α² √(cosθ_l cosθ_v)).
    Ward {
        /// k_s.
        scale: Rgb,
        /// α.
        roughness: f64,
    },
    /// Ashikhmin & Shirley 2000, isotropic, without their diffuse term:
    /// k_s (n + 1) cosⁿθ_h F/(8π cosθ_d max(cosθ_l, cosθ_v)), with Schlick's F.
    AshikhminShirley {
        /// k_s.
        scale: Rgb,
        /// F at normal incidence.
        reflectance: f64,
        /// n.
        sharpness: f64,
    },
    /// The microfacet model of Löw et al. 2012, eq. 15: A F G (1 + B (1 − cosθ_h))^−C/(π cosθ_l cosθ_v),
    /// with the F of a dielectric and the G of V-shaped grooves. The π is not in the paper, but in the
    /// parameters of its supplement.
    LowMicrofacet {
        /// A.
        scale: Rgb,
        /// B.
        slope: f64,
        /// C.
        falloff: f64,
        /// Relative index of refraction.
        eta: f64,
    },
    /// The shifted gamma distribution of Bagher, Soler, Holzschuch 2012, every parameter per channel:
    /// k_s F D G(θ_l) G(θ_v)/(π cosθ_l cosθ_v), F = F₀ + (1 − F₀)(1 − cosθ_d)⁵ − F₁ cosθ_d,
    /// D = K e^−x x^−p/(π cos⁴θ_h) with x = α + tan²θ_h/α,
    /// G = 1 + λ (1 − exp((s max(θ − θ₀, 0))^k)), limited to [0, 1]. The paper has c in the place of sᵏ, and published
    /// ones are as large as 10¹⁰⁹, where float32 ends at 10³⁸.
    ShiftedGamma {
        /// k_s.
        scale: Rgb,
        /// α.
        alpha: Rgb,
        /// p.
        power: Rgb,
        /// F₀ and F₁.
        fresnel: [Rgb; 2],
        /// K.
        norm: Rgb,
        /// λ, s, k and θ₀.
        masking: [Rgb; 4],
    },
}

/// The name of a specular lobe: what the materials of a library have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lobe {
    /// [`Specular::CookTorrance`].
    CookTorrance,
    /// [`Specular::Ward`].
    Ward,
    /// [`Specular::AshikhminShirley`].
    AshikhminShirley,
    /// [`Specular::LowMicrofacet`].
    LowMicrofacet,
    /// [`Specular::ShiftedGamma`].
    ShiftedGamma,
}

impl Specular {
    /// Its name.
    #[must_use]
    pub fn lobe(&self) -> Lobe {
        match self {
            Specular::CookTorrance { .. } => Lobe::CookTorrance,
            Specular::Ward { .. } => Lobe::Ward,
            Specular::AshikhminShirley { .. } => Lobe::AshikhminShirley,
            Specular::LowMicrofacet { .. } => Lobe::LowMicrofacet,
            Specular::ShiftedGamma { .. } => Lobe::ShiftedGamma,
        }
    }

    /// All parameters in the order of their declaration, colour channels together.
    #[must_use]
    pub fn numbers(&self) -> Vec<f64> {
        self.values().into_iter().flat_map(|(_, values)| values).copied().collect()
    }

    /// The lobe with these parameters, in the order of [`Specular::numbers`].
    ///
    /// # Errors
    /// In words, another number of parameters.
    pub fn from_numbers(lobe: Lobe, numbers: &[f64]) -> Result<Specular, Invalid> {
        let rgb = |at: usize| [numbers[at], numbers[at + 1], numbers[at + 2]];
        let count = match lobe {
            Lobe::Ward => 4,
            Lobe::CookTorrance | Lobe::AshikhminShirley => 5,
            Lobe::LowMicrofacet => 6,
            Lobe::ShiftedGamma => 30,
        };
        if numbers.len() != count {
            return Err(
                format!("the specular lobe has {} parameters, expected {count}", numbers.len()).into()
            );
        }
        let scale = rgb(0);
        Ok(match lobe {
            Lobe::CookTorrance => {
                Specular::CookTorrance { scale, reflectance: numbers[3], roughness: numbers[4] }
            }
            Lobe::Ward => Specular::Ward { scale, roughness: numbers[3] },
            Lobe::AshikhminShirley => {
                Specular::AshikhminShirley { scale, reflectance: numbers[3], sharpness: numbers[4] }
            }
            Lobe::LowMicrofacet => {
                Specular::LowMicrofacet { scale, slope: numbers[3], falloff: numbers[4], eta: numbers[5] }
            }
            Lobe::ShiftedGamma => Specular::ShiftedGamma {
                scale,
                alpha: rgb(3),
                power: rgb(6),
                fresnel: [rgb(9), rgb(12)],
                norm: rgb(15),
                masking: [rgb(18), rgb(21), rgb(24), rgb(27)],
            },
        })
    }

    /// The parameters by name.
    fn values(&self) -> Vec<(&'static str, &[f64])> {
        use std::slice::from_ref;
        match self {
            Specular::CookTorrance { scale, reflectance, roughness } => {
                vec![
                    ("scale", scale),
                    ("reflectance", from_ref(reflectance)),
                    ("roughness", from_ref(roughness)),
                ]
            }
            Specular::Ward { scale, roughness } => vec![("scale", scale), ("roughness", from_ref(roughness))],
            Specular::AshikhminShirley { scale, reflectance, sharpness } => {
                vec![
                    ("scale", scale),
                    ("reflectance", from_ref(reflectance)),
                    ("sharpness", from_ref(sharpness)),
                ]
            }
            Specular::LowMicrofacet { scale, slope, falloff, eta } => vec![
                ("scale", scale),
                ("slope", from_ref(slope)),
                ("falloff", from_ref(falloff)),
                ("eta", from_ref(eta)),
            ],
            Specular::ShiftedGamma { scale, alpha, power, fresnel, norm, masking } => vec![
                ("scale", scale),
                ("alpha", alpha),
                ("power", power),
                ("fresnel", fresnel.as_flattened()),
                ("norm", norm),
                ("masking", masking.as_flattened()),
            ],
        }
    }
}

/// One material.
///
/// ```
/// use glimt_core::models::analytic::{Analytic, Parameters, Specular};
/// use glimt_core::{Brdf, Vec3};
///
/// let specular = Specular::Ward { scale: [0.1; 3], roughness: 0.2 };
/// let paint = Analytic::new(Parameters { diffuse: [0.5, 0.1, 0.1], specular }).unwrap();
/// let f = paint.eval(Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.6, 0.0, 0.8));
/// assert!(f.x > f.y && f.y == f.z);
/// ```
#[derive(Clone, Debug)]
pub struct Analytic {
    parameters: Parameters,
}

impl Analytic {
    /// The material with these parameters, as float32 holds them: that is how a library stores them.
    ///
    /// # Errors
    /// In words, a parameter that is not finite, a negative k_d, or a roughness that is not positive.
    pub fn new(parameters: Parameters) -> Result<Self, Invalid> {
        let stored = |x: f64| f64::from(x as f32);
        let numbers: Vec<f64> = parameters.specular.numbers().into_iter().map(stored).collect();
        let specular = Specular::from_numbers(parameters.specular.lobe(), &numbers)?;
        let parameters = Parameters { diffuse: parameters.diffuse.map(stored), specular };
        let values = parameters.specular.values();
        for (name, values) in values.into_iter().chain([("diffuse", &parameters.diffuse[..])]) {
            let is_positive = matches!(name, "roughness" | "alpha");
            let is_signed = matches!(name, "fresnel" | "masking" | "falloff" | "power");
            let fits = |x: &f64| x.is_finite() && (is_signed || *x >= 0.0) && !(is_positive && *x == 0.0);
            if let Some(x) = values.iter().find(|x| !fits(x)) {
                let expected = if is_positive {
                    "positive"
                } else if is_signed {
                    "finite"
                } else {
                    "not negative"
                };
                return Err(format!("{name} is {x}, expected a number that is {expected}").into());
            }
        }
        Ok(Analytic { parameters })
    }

    /// The material's parameters.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }
}

impl Model for Analytic {
    const KIND: &'static str = "analytic";

    fn describe(&self) -> String {
        format!("Lambert and {}", spelled(&self.parameters.specular.lobe()))
    }

    fn is_isotropic(&self) -> bool {
        true
    }

    fn is_reciprocal(&self) -> bool {
        true
    }
}

impl Brdf for Analytic {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        let angles = Angles::new(light.as_dvec3().normalize(), view.as_dvec3().normalize());
        let f = |c: usize| {
            let f = self.parameters.diffuse[c] / PI + self.parameters.specular.eval(&angles, c);
            // Far from where it was fitted a model may divide 0 by 0 or go below 0.
            if f > 0.0 { f.min(MAX_F) as f32 } else { 0.0 }
        };
        Vec3::new(f(0), f(1), f(2))
    }
}

/// What the models see of two directions.
struct Angles {
    cos_light: f64,
    cos_view: f64,
    cos_h: f64,
    /// 1 − cosθ_h and tan²θ_h, with no difference of close numbers at the normal.
    one_minus_cos_h: f64,
    tan2_h: f64,
    cos_d: f64,
}

impl Angles {
    fn new(light: DVec3, view: DVec3) -> Angles {
        let sum = light + view;
        let across = sum.truncate().length_squared();
        let length = sum.length();
        Angles {
            cos_light: light.z,
            cos_view: view.z,
            cos_h: sum.z / length,
            one_minus_cos_h: across / (length * (length + sum.z)),
            tan2_h: across / (sum.z * sum.z),
            cos_d: 0.5 * length,
        }
    }

    /// The G of V-shaped grooves (Torrance & Sparrow 1967).
    fn grooves(&self) -> f64 {
        (2.0 * self.cos_h * self.cos_light.min(self.cos_view) / self.cos_d).min(1.0)
    }

    fn foreshortening(&self) -> f64 {
        self.cos_light * self.cos_view
    }
}

impl Specular {
    fn eval(&self, a: &Angles, c: usize) -> f64 {
        match self {
            Specular::CookTorrance { scale, reflectance, roughness } => {
                let m2 = roughness * roughness;
                let ndf = (-a.tan2_h / m2).exp() / (PI * m2 * a.cos_h.powi(4));
                scale[c] * schlick(*reflectance, a.cos_d) * ndf * a.grooves() / (PI * a.foreshortening())
            }
            Specular::Ward { scale, roughness } => {
                let m2 = roughness * roughness;
                scale[c] * (-a.tan2_h / m2).exp() / (4.0 * PI * m2 * a.foreshortening().sqrt())
            }
            Specular::AshikhminShirley { scale, reflectance, sharpness } => {
                let lobe = (sharpness + 1.0) / (8.0 * PI) * (sharpness * (-a.one_minus_cos_h).ln_1p()).exp();
                scale[c] * lobe * schlick(*reflectance, a.cos_d) / (a.cos_d * a.cos_light.max(a.cos_view))
            }
            Specular::LowMicrofacet { scale, slope, falloff, eta } => {
                let ndf = (1.0 + slope * a.one_minus_cos_h).powf(-falloff);
                scale[c] * ndf * dielectric(*eta, a.cos_d) * a.grooves() / (PI * a.foreshortening())
            }
            Specular::ShiftedGamma { scale, alpha, power, fresnel, norm, masking } => {
                let x = alpha[c] + a.tan2_h / alpha[c];
                let ndf = norm[c] * (-x).exp() * x.powf(-power[c]) / (PI * a.cos_h.powi(4));
                let reflected = schlick(fresnel[0][c], a.cos_d) - fresnel[1][c] * a.cos_d;
                let masking = |cos: f64| {
                    let [lambda, rate, exponent, start] =
                        [masking[0][c], masking[1][c], masking[2][c], masking[3][c]];
                    let beyond = (cos.acos() - start).max(0.0);
                    (1.0 + lambda * (1.0 - (rate * beyond).max(0.0).powf(exponent).exp())).clamp(0.0, 1.0)
                };
                let both = masking(a.cos_light) * masking(a.cos_view);
                scale[c] * reflected * ndf * both / (PI * a.foreshortening())
            }
        }
    }
}

/// Schlick 1994.
fn schlick(reflectance: f64, cos: f64) -> f64 {
    reflectance + (1.0 - reflectance) * (1.0 - cos).powi(5)
}

/// Fresnel's reflectance of a dielectric for unpolarized light as Cook & Torrance write it. Below η = 1, where
/// g is imaginary, it is total.
fn dielectric(eta: f64, cos: f64) -> f64 {
    let square = eta * eta + cos * cos - 1.0;
    if square < 0.0 {
        return 1.0;
    }
    let g = square.sqrt();
    let parallel = (cos * (g + cos) - 1.0) / (cos * (g - cos) + 1.0);
    0.5 * ((g - cos) / (g + cos)).powi(2) * (1.0 + parallel * parallel)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::microfacet;
    use proptest::prelude::*;

    /// A material of every lobe.
    pub(crate) fn specimens() -> [Parameters; 5] {
        let scale = [0.3, 0.2, 0.1];
        [
            Specular::CookTorrance { scale, reflectance: 0.1, roughness: 0.2 },
            Specular::Ward { scale, roughness: 0.15 },
            Specular::AshikhminShirley { scale, reflectance: 0.08, sharpness: 100.0 },
            Specular::LowMicrofacet { scale: [20.0, 15.0, 10.0], slope: 1000.0, falloff: 1.2, eta: 1.5 },
            Specular::ShiftedGamma {
                scale,
                alpha: [0.02; 3],
                power: [0.6; 3],
                fresnel: [[0.1; 3], [-0.05; 3]],
                norm: [20.0; 3],
                masking: [[2.0; 3], [0.5; 3], [9.0; 3], [0.2; 3]],
            },
        ]
        .map(|specular| Parameters { diffuse: [0.2, 0.1, 0.05], specular })
    }

    fn f(specular: Specular, light: Vec3, view: Vec3) -> f32 {
        Analytic::new(Parameters { diffuse: [0.0; 3], specular }).unwrap().eval(light, view).x
    }

    /// Light at 30° in the mirror direction of the view.
    fn mirror() -> (Vec3, Vec3) {
        let cos = 0.75f32.sqrt();
        (Vec3::new(0.5, 0.0, cos), Vec3::new(-0.5, 0.0, cos))
    }

    #[test]
    fn peaks_have_the_values_that_the_formulas_give_by_hand() {
        let (light, view) = mirror();
        let (scale, cos2) = ([1.0; 3], 0.75f64);
        let close = |found: f32, expected: f64| {
            assert!((f64::from(found) / expected - 1.0).abs() < 1e-5, "{found} for {expected}");
        };
        // θ_h = 0: D = 1/(π m²), G = 1, and F nearly that at 30°.
        let fresnel = 0.04 + 0.96 * (1.0 - cos2.sqrt()).powi(5);
        let roughness = 0.1;
        close(
            f(Specular::CookTorrance { scale, reflectance: 0.04, roughness }, light, view),
            fresnel / (PI * PI * 0.01 * cos2),
        );
        close(f(Specular::Ward { scale, roughness }, light, view), 1.0 / (4.0 * PI * 0.01 * cos2.sqrt()));
        close(
            f(Specular::AshikhminShirley { scale, reflectance: 0.04, sharpness: 99.0 }, light, view),
            100.0 / (8.0 * PI) * fresnel / cos2,
        );
        let low = Specular::LowMicrofacet { scale, slope: 500.0, falloff: 2.0, eta: 1.5 };
        close(f(low, light, view), microfacet::reference::fresnel(cos2.sqrt(), 1.5) / (PI * cos2));
    }

    #[test]
    fn lobes_fall_to_the_fraction_that_their_width_says() {
        // Half vector at tan θ_h = m from the normal, in the plane of incidence with cosθ_d kept.
        let half = |tan: f64| DVec3::new(tan, 0.0, 1.0).normalize();
        let pair = |tan: f64| {
            let across = DVec3::Y * 0.5;
            let along = half(tan) * 0.75f64.sqrt();
            ((along + across).as_vec3(), (along - across).as_vec3())
        };
        let ratio = |specular: Specular, tan: f64| {
            let ((l0, v0), (l, v)) = (pair(0.0), pair(tan));
            let foreshortening = f64::from(l.z * v.z / (l0.z * v0.z));
            (f64::from(f(specular.clone(), l, v) / f(specular, l0, v0)), foreshortening)
        };
        let scale = [1.0; 3];
        let (ward, cosines) = ratio(Specular::Ward { scale, roughness: 0.1 }, 0.1);
        assert!((ward * cosines.sqrt() - (-1.0f64).exp()).abs() < 1e-4, "{ward}");
        let low = Specular::LowMicrofacet { scale, slope: 1000.0, falloff: 1.0, eta: 1.5 };
        let (low, cosines) = ratio(low, (2.0f64 * 1e-3).sqrt());
        assert!((low * cosines - 0.5).abs() < 2e-3, "{low}");
    }

    fn direction() -> impl Strategy<Value = Vec3> {
        (1e-6..1.0f32, 0.0..std::f32::consts::TAU).prop_map(|(z, phi)| {
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn every_lobe_is_finite_not_negative_and_reciprocal(light in direction(), view in direction()) {
            for parameters in specimens() {
                let material = Analytic::new(parameters).unwrap();
                let f = material.eval(light, view);
                prop_assert!(f.is_finite() && f.min_element() >= 0.0, "{f}");
                let swapped = material.eval(view, light);
                prop_assert!((f - swapped).abs().max_element() <= 1e-5 * f.max_element());
            }
        }
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        let refused = |specular| Analytic::new(Parameters { diffuse: [0.1; 3], specular }).unwrap_err();
        assert!(
            refused(Specular::Ward { scale: [1.0; 3], roughness: 0.0 })
                .to_string()
                .contains("roughness is 0, expected")
        );
        assert!(
            refused(Specular::Ward { scale: [-1.0; 3], roughness: 0.1 }).to_string().contains("scale is -1")
        );
        let nan = Specular::LowMicrofacet { scale: [1.0; 3], slope: f64::NAN, falloff: 1.0, eta: 1.5 };
        assert!(refused(nan).to_string().contains("slope is NaN"));
        // Libraries hold float32: beyond its range is out of range.
        let large = Specular::LowMicrofacet { scale: [1.0; 3], slope: 1e40, falloff: 1.0, eta: 1.5 };
        assert!(refused(large).to_string().contains("slope is inf"));
        assert!(
            refused(Specular::Ward { scale: [1.0; 3], roughness: 1e-60 })
                .to_string()
                .contains("roughness is 0, expected")
        );
    }
}
