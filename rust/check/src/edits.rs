//! The law of edits: an edited material reflects no more than the largest of what it did before, what its analytic
//! part does now, and everything.

use glam::Vec3;
use glimt_core::models::ggx::Ggx;
use glimt_core::{Material, SampleBrdf};

use crate::verdict::{Finding, Measure, Test};
use crate::views::View;

/// Most that an albedo may exceed the largest of the three: room is found between views by interpolation.
pub const EDIT_EXCESS: f64 = 1.05;

/// Views from the normal to grazing, at which albedos are compared.
const ELEVATIONS: [f64; 10] = [0.0, 15.0, 30.0, 45.0, 55.0, 65.0, 75.0, 81.0, 85.0, 88.0];
/// Azimuths of a material that is not isotropic.
const AZIMUTHS: [f64; 3] = [17.0, 71.0, 228.0];
/// Samples for each view.
const SAMPLES: usize = 4096;

/// Directional albedos at views that suit `like`.
#[must_use]
pub fn albedos(material: &Material, like: &Material) -> Vec<(View, [f64; 3])> {
    let azimuths = if like.is_isotropic() { &AZIMUTHS[..1] } else { &AZIMUTHS[..] };
    let views = ELEVATIONS.iter().flat_map(|&theta| azimuths.iter().map(move |&phi| View { theta, phi }));
    views.map(|view| (view, albedo(material, view.direction()))).collect()
}

/// Mean weight of the material's own samples, over points of the R3 sequence (Roberts 2018).
fn albedo(material: &Material, view: Vec3) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for i in 0..SAMPLES {
        let u = [0.819_172_513, 0.671_043_607, 0.549_700_478]
            .map(|step: f64| (0.5 + i as f64 * step).fract() as f32);
        let weight = material.sample(view, u.into()).weight;
        (0..3).for_each(|c| sum[c] += f64::from(weight[c]));
    }
    sum.map(|sum| sum / SAMPLES as f64)
}

/// What an edited material may reflect.
pub struct EditLaw {
    /// Largest albedo of the material before the edit, and 1.
    most: [f64; 3],
}

impl EditLaw {
    /// For edits of `before`, and mixes of it with others.
    #[must_use]
    pub fn new(before: &Material) -> EditLaw {
        EditLaw { most: greatest(&albedos(before, before)).map(|albedo| albedo.max(1.0)) }
    }

    /// For mixes of the materials of two laws.
    #[must_use]
    pub fn or(&self, other: &EditLaw) -> EditLaw {
        EditLaw { most: std::array::from_fn(|c| self.most[c].max(other.most[c])) }
    }

    /// [`Test::EditEnergy`]: one finding for each view.
    #[must_use]
    pub fn findings(&self, edited: &Material) -> Vec<Finding> {
        let mut most = self.most;
        if let Some(analytic) = edited.microfacet().and_then(|p| Ggx::new(*p).ok()) {
            let analytic = greatest(&albedos(&analytic.into(), edited));
            most = std::array::from_fn(|c| most[c].max(analytic[c]));
        }
        let finding = |(view, albedo): (View, [f64; 3])| {
            let excess = |c: usize| albedo[c] / most[c];
            let channel = (0..3).max_by(|&a, &b| excess(a).total_cmp(&excess(b))).expect("three");
            Finding::new(Test::EditEnergy, Measure::error(excess(channel), EDIT_EXCESS))
                .at(view)
                .note(format!("albedo {:.4}, at most {:.4}", albedo[channel], most[channel]))
        };
        albedos(edited, edited).into_iter().map(finding).collect()
    }
}

fn greatest(albedos: &[(View, [f64; 3])]) -> [f64; 3] {
    albedos.iter().fold([0.0; 3], |most, (_, albedo)| std::array::from_fn(|c| most[c].max(albedo[c])))
}
