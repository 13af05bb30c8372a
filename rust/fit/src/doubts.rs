//! What a fit goes on with, but what is hardly meant: inputs that say little or nothing, and results that no
//! material has.

use std::collections::HashMap;
use std::f32::consts::TAU;
use std::fmt;

use glam::Vec3;
use glimt_core::library::Entry;
use glimt_core::{Material, SampleBrdf};
use rayon::prelude::*;

use crate::input::Input;
use crate::truth::Truth;

/// Something that a fit goes on with, but that is hardly meant.
#[derive(Clone, Debug, PartialEq)]
pub enum Doubt {
    /// All values that were looked at are 0.
    Black {
        /// The material.
        material: String,
    },
    /// Two materials come from the same bytes.
    Same {
        /// The two materials.
        materials: [String; 2],
    },
    /// The samples have fewer values than the model has numbers, so that any number of fits go through them.
    FewSamples {
        /// The material.
        material: String,
        /// Samples that are fitted to, of three values each.
        samples: usize,
        /// Numbers of the model that are the material's.
        numbers: usize,
    },
    /// A few samples are far above all others, and the fit is mostly about them.
    Outliers {
        /// The material.
        material: String,
        /// How many they are.
        count: usize,
        /// The least of them and the largest of the others, both the largest channel of f in sr⁻¹.
        gap: [f32; 2],
    },
    /// Several samples share the largest value of a channel, as where a sensor ends.
    Saturated {
        /// The material.
        material: String,
        /// How many they are.
        count: usize,
        /// Their value in sr⁻¹.
        value: f32,
    },
    /// The material is anisotropic and the model is not.
    Anisotropic {
        /// The material.
        material: String,
    },
    /// The fitted model reflects more light than arrives.
    Albedo {
        /// The material.
        material: String,
        /// Albedo of the channel and view that has the largest.
        albedo: f32,
        /// Angle of that view from the normal in degrees.
        view: f32,
    },
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Doubt::Black { material } => {
                write!(f, "material \"{material}\" is black: every value that was looked at is 0")
            }
            Doubt::Same { materials: [first, second] } => {
                write!(f, "materials \"{first}\" and \"{second}\" come from files with the same content")
            }
            Doubt::FewSamples { material, samples, numbers } => write!(
                f,
                "material \"{material}\" has {samples} samples of 3 values, fewer than the {numbers} numbers of the \
                 model: between the samples it is arbitrary"
            ),
            Doubt::Outliers { material, count, gap: [above, below] } => write!(
                f,
                "material \"{material}\" has outliers: {count} of its samples, from {above:.3e} on, are far above all \
                 others, which end at {below:.3e}, and the fit is mostly about them"
            ),
            Doubt::Saturated { material, count, value } => write!(
                f,
                "material \"{material}\" looks saturated: {count} of its samples share the largest value, {value}"
            ),
            Doubt::Anisotropic { material } => write!(
                f,
                "material \"{material}\" is anisotropic, and the model is not: it is fitted to half vectors in one \
                 plane, as if the others were the same"
            ),
            Doubt::Albedo { material, albedo, view } => write!(
                f,
                "material \"{material}\" reflects more light than arrives: its fitted albedo is {albedo:.2} at \
                 {view:.0}° from the normal"
            ),
        }
    }
}

/// What is hardly meant about `inputs`. `numbers` is how many numbers the model has for each of them, where few
/// samples leave them open.
#[must_use]
pub fn doubts(inputs: &[Input], numbers: Option<usize>) -> Vec<Doubt> {
    let mut doubts = Vec::new();
    let mut seen: HashMap<(&str, usize), &str> = HashMap::new();
    for input in inputs {
        let material = input.name.clone();
        if input.truth.is_black() {
            doubts.push(Doubt::Black { material: material.clone() });
        }
        if let Truth::Samples { f, .. } = input.truth {
            let numbers = numbers.filter(|&numbers| 3 * f.len() < numbers);
            doubts.extend(numbers.map(|numbers| {
                let (material, samples) = (material.clone(), f.len());
                Doubt::FewSamples { material, samples, numbers }
            }));
            doubts.extend(outliers(&material, f));
            doubts.extend(saturated(&material, f));
        }
        // Materials of one library have the same file and are told apart by their place in it.
        let place = inputs.iter().take_while(|other| other.name != input.name);
        let place = place.filter(|other| other.origin.source == input.origin.source).count();
        if input.origin.sha256.is_empty() {
            continue;
        }
        if let Some(first) = seen.insert((&input.origin.sha256, place), &input.name) {
            doubts.push(Doubt::Same { materials: [first.to_owned(), material] });
        }
    }
    doubts
}

/// What is lost when tables over single angles are fitted to `inputs`: they have no azimuth of the half vector.
#[must_use]
pub fn doubts_of_tables(inputs: &[Input]) -> Vec<Doubt> {
    let anisotropic = inputs.iter().filter(|input| !input.isotropic);
    anisotropic.map(|input| Doubt::Anisotropic { material: input.name.clone() }).collect()
}

/// What is hardly meant about fitted materials.
#[must_use]
pub fn doubts_of(entries: &[Entry]) -> Vec<Doubt> {
    let doubt = |entry: &Entry| {
        let (albedo, view) = largest_albedo(&entry.material)?;
        Some(Doubt::Albedo { material: entry.name.clone(), albedo, view })
    };
    entries.par_iter().filter_map(doubt).collect()
}

/// Factor between neighbouring values that separates outliers from the rest. A highlight of which one sample in a
/// hundred sees the peak stays below it unless the lobe is narrower than any goniometer resolves.
const OUTLIER_GAP: f32 = 100.0;
/// Most samples that are outliers: one, or this share.
const OUTLIER_SHARE: f64 = 0.02;

/// The few samples that lie above a gap, if there is one.
fn outliers(material: &str, f: &[Vec3]) -> Option<Doubt> {
    let mut largest: Vec<f32> = f.iter().map(|f| f.max_element()).collect();
    largest.sort_unstable_by(|a, b| b.total_cmp(a));
    let most = ((OUTLIER_SHARE * f.len() as f64) as usize).max(1);
    let count = (1..=most.min(f.len().saturating_sub(1)))
        .rfind(|&count| largest[count] > 0.0 && largest[count - 1] > OUTLIER_GAP * largest[count])?;
    let gap = [largest[count - 1], largest[count]];
    Some(Doubt::Outliers { material: material.to_owned(), count, gap })
}

/// Fewest samples of one value that are no accident.
const SATURATED_COUNT: usize = 3;
/// How far above the median the largest value has to be for its repetition to mean anything: what is the same
/// everywhere is not saturated.
const SATURATED_RATIO: f32 = 2.0;

/// The samples that share the largest value of a channel, if these are several.
fn saturated(material: &str, f: &[Vec3]) -> Option<Doubt> {
    let of_channel = |channel: usize| {
        let mut values: Vec<f32> = f.iter().map(|f| f[channel]).collect();
        values.sort_unstable_by(f32::total_cmp);
        let (value, median) = (*values.last()?, values[values.len() / 2]);
        let count = values.iter().rev().take_while(|&&other| other == value).count();
        let is_saturated = count >= SATURATED_COUNT && value > SATURATED_RATIO * median;
        is_saturated.then(|| Doubt::Saturated { material: material.to_owned(), count, value })
    };
    (0..3).find_map(of_channel)
}

/// Angles of the views whose albedo is looked at, in degrees from the normal. Beyond them measurements themselves
/// are above 1.
const ALBEDO_VIEWS: [f32; 6] = [0.0, 15.0, 30.0, 45.0, 60.0, 75.0];
/// Azimuths of each, as anisotropic materials differ there.
const ALBEDO_AZIMUTHS: usize = 4;
/// Lights of every view.
const ALBEDO_LIGHTS: usize = 2048;
/// Albedos up to this are accepted: a fit is not exact, and a white material is near 1.
const LARGEST_ALBEDO: f64 = 1.05;
/// Standard errors by which an albedo has to be above that.
const SURE: f64 = 4.0;

/// The largest albedo of all views and channels and the view's angle, where it is above 1 without doubt.
fn largest_albedo(material: &Material) -> Option<(f32, f32)> {
    let azimuths = if material.is_isotropic() { 1 } else { ALBEDO_AZIMUTHS };
    let views = ALBEDO_VIEWS.into_iter().flat_map(|theta| (0..azimuths).map(move |turn| (theta, turn)));
    views
        .map(|(theta, turn)| {
            let (sin, cos) = theta.to_radians().sin_cos();
            let phi = turn as f32 / azimuths as f32 * TAU;
            (sure_albedo(material, Vec3::new(sin * phi.cos(), sin * phi.sin(), cos)), theta)
        })
        .filter_map(|(albedo, theta)| albedo.map(|albedo| (albedo, theta)))
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

/// The largest albedo of the channels of one view, where it is above 1 without doubt.
fn sure_albedo(material: &Material, view: Vec3) -> Option<f32> {
    let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
    for i in 0..ALBEDO_LIGHTS {
        // The R3 sequence (Roberts 2018).
        let u = |step: f64| ((i as f64 + 0.5) * step).fract() as f32;
        let weight = material.sample(view, Vec3::new(u(0.819_172_5), u(0.671_043_6), u(0.549_700_5))).weight;
        for c in 0..3 {
            let weight = f64::from(weight[c]);
            sum[c] += weight;
            squares[c] += weight * weight;
        }
    }
    let n = ALBEDO_LIGHTS as f64;
    let sure = |c: usize| {
        let mean = sum[c] / n;
        let error = ((squares[c] / n - mean * mean).max(0.0) / n).sqrt();
        (mean - SURE * error > LARGEST_ALBEDO).then_some(mean as f32)
    };
    (0..3).filter_map(sure).max_by(f32::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::library::Origin;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::analytic::{Analytic, Parameters, Specular};
    use glimt_core::models::ggx::Ggx;

    fn of_samples(f: &[Vec3], numbers: usize) -> Vec<Doubt> {
        let directions = vec![Vec3::Z; f.len()];
        let truth = Truth::Samples { light: &directions, view: &directions, f };
        let origin = Origin::default();
        doubts(&[Input { name: "cloth".into(), truth, isotropic: true, origin }], Some(numbers))
    }

    /// Values that vary by a factor of a few, as those of a matt material.
    fn matt(count: usize) -> Vec<Vec3> {
        (0..count).map(|i| Vec3::new(0.1, 0.2, 0.3) * (1.0 + (i as f32 * 0.37).sin().abs())).collect()
    }

    #[test]
    fn samples_that_are_many_and_plausible_raise_no_doubt() {
        assert_eq!(of_samples(&matt(1000), 2000), []);
        // All the same, as a Lambertian surface is, and a highlight over it.
        assert_eq!(of_samples(&[Vec3::splat(0.2); 100], 8), []);
        let highlight = |i: usize| Vec3::splat(0.05 + 40.0 * (-(i as f32) / 20.0).exp());
        assert_eq!(of_samples(&(0..300).map(highlight).collect::<Vec<_>>(), 8), []);
    }

    #[test]
    fn fewer_values_than_numbers_are_too_few() {
        let found = of_samples(&matt(100), 301);
        assert_eq!(found, [Doubt::FewSamples { material: "cloth".into(), samples: 100, numbers: 301 }]);
        let words = found[0].to_string();
        assert!(words.contains("100 samples of 3 values, fewer than the 301 numbers"), "{words}");
    }

    #[test]
    fn a_few_values_far_above_the_others_are_outliers() {
        let mut f = matt(200);
        f[17].y = 1e30;
        f[90] = Vec3::splat(9e29);
        let [Doubt::Outliers { count: 2, gap: [above, below], .. }] = of_samples(&f, 8)[..] else {
            panic!("{:?}", of_samples(&f, 8))
        };
        assert!(above == 9e29 && below < 1.0);
    }

    #[test]
    fn a_largest_value_that_comes_again_is_saturated() {
        let mut f = matt(200);
        (0..200).step_by(20).for_each(|i| f[i].z = 4.0);
        let expected = Doubt::Saturated { material: "cloth".into(), count: 10, value: 4.0 };
        assert_eq!(of_samples(&f, 8), [expected]);
    }

    #[test]
    fn albedos_above_one_are_told_and_those_of_white_are_not() {
        let entry =
            |name: &str, material: Material| Entry { name: name.into(), material, origin: Origin::default() };
        let ggx = |alpha| Ggx::new(Microfacet { kd: [1.0; 3], eta: [1.01; 3], alpha: [alpha; 2] }).unwrap();
        let diffuse = |albedo| {
            let specular = Specular::Ward { scale: [0.0; 3], roughness: 0.3 };
            Analytic::new(Parameters { diffuse: [0.5, albedo, 0.5], specular }).unwrap()
        };
        let entries = [
            entry("white", ggx(0.5).into()),
            entry("mirror", ggx(0.001).into()),
            entry("lamp", diffuse(5.0).into()),
        ];
        let [Doubt::Albedo { material, albedo, .. }] = &doubts_of(&entries)[..] else {
            panic!("{:?}", doubts_of(&entries))
        };
        assert_eq!(material, "lamp");
        assert!((albedo - 5.0).abs() < 0.1, "{albedo}");
    }
}
