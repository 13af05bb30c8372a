//! The laws of edits and mixes, over the shipped materials and fits of every form: an edited material has no more
//! energy than it may, and changes no faster than the edit.

use std::path::Path;

use glimt_check::edits::EditLaw;
use glimt_check::verdict::{Finding, Measure};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::edit::{Albedos, Views};
use glimt_core::models::ggx::Ggx;
use glimt_core::{Library, Material};
use rayon::prelude::*;

const ALPHAS: [f32; 5] = [0.02, 0.08, 0.2, 0.5, 1.0];
const ETAS: [f32; 4] = [1.05, 1.5, 2.5, 4.0];
const KDS: [[f32; 3]; 4] = [[0.0; 3], [0.1, 0.2, 0.6], [0.9; 3], [1.0; 3]];

fn shipped() -> Library {
    Library::open(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/models/rgl.safetensors")).unwrap()
}

/// Each parameter alone, and all together.
fn edits(p: Microfacet) -> Vec<Microfacet> {
    let alpha = |alpha| Microfacet { alpha: [alpha; 2], ..p };
    let eta = |p: Microfacet, eta| Microfacet { eta: [eta; 3], ..p };
    let kd = |p: Microfacet, kd| Microfacet { kd, ..p };
    let mut edits = Vec::new();
    edits.extend(ALPHAS.map(alpha));
    edits.extend(ETAS.map(|n| eta(p, n)));
    edits.extend(KDS.map(|k| kd(p, k)));
    for a in ALPHAS {
        edits.extend(
            [ETAS[0], ETAS[3]].iter().flat_map(|&n| [KDS[0], KDS[3]].map(|k| kd(eta(alpha(a), n), k))),
        );
    }
    edits
}

fn worst(findings: &[Finding]) -> f64 {
    let values = findings.iter().map(|finding| match finding.measure {
        Measure::Error { value, .. } => value,
        _ => panic!("the law of edits measures errors"),
    });
    values.fold(0.0, f64::max)
}

/// Most that the law lets an albedo exceed, over every edit.
fn assert_energy(name: &str, material: &Material) {
    let law = EditLaw::new(material);
    edits(*material.microfacet().unwrap()).into_par_iter().for_each(|p| {
        let findings = law.findings(&material.with_microfacet(p).unwrap());
        let worst = worst(&findings);
        assert!(worst <= glimt_check::edits::EDIT_EXCESS, "{name} {p:?}: {worst} of what it may have");
    });
}

#[test]
fn edits_of_shipped_materials_keep_their_energy() {
    for entry in shipped().entries() {
        assert_energy(&entry.name, &entry.material);
    }
}

/// A step of 2 % along each parameter, at `t` of the way through its range.
fn steps(p: Microfacet, t: f32) -> [[Microfacet; 2]; 3] {
    let at = |from: f32, to: f32| from * (to / from).powf(t);
    let pair = |of: &dyn Fn(f32) -> Microfacet| [of(1.0), of(1.02)];
    [
        pair(&|factor| Microfacet { kd: [(at(0.01, 0.98) * factor).min(1.0); 3], ..p }),
        pair(&|factor| Microfacet { eta: [at(1.05, 4.0) * factor; 3], ..p }),
        pair(&|factor| Microfacet { alpha: [at(0.02, 0.98) * factor; 2], ..p }),
    ]
}

/// Largest change of an albedo.
fn jump(a: &Albedos, b: &Albedos) -> f32 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn albedos_of_shipped_materials_change_no_faster_than_edits() {
    for entry in shipped().entries() {
        let p = *entry.material.microfacet().unwrap();
        let own = p.alpha.map(|a| a * 1.02);
        let mut pairs = vec![[p, Microfacet { alpha: own, ..p }]];
        pairs.extend((0..8).flat_map(|i| steps(p, i as f32 / 7.0)));
        pairs.into_par_iter().for_each(|[a, b]| {
            let views = Views::new(entry.material.is_isotropic(), &[p.alpha, a.alpha, b.alpha]);
            let albedos = [a, b].map(|p| views.albedos(&entry.material.with_microfacet(p).unwrap()));
            // The analytic part has steps of its own: F₀ doubles from η = 1.05 to 1.07.
            let analytic = [a, b].map(|p| views.albedos(&Ggx::new(p).unwrap()));
            let jump = jump(&albedos[0], &albedos[1]) - self::jump(&analytic[0], &analytic[1]);
            assert!(jump <= 0.05, "{}: {a:?} to {b:?}: {jump}", entry.name);
        });
    }
}

#[test]
fn an_edit_that_is_taken_back_is_the_shipped_material_to_the_bit() {
    let (light, view) = (glimt_core::Vec3::new(0.48, 0.36, 0.8), glimt_core::Vec3::new(-0.6, 0.0, 0.8));
    for entry in shipped().entries() {
        use glimt_core::Brdf;
        let p = *entry.material.microfacet().unwrap();
        for edit in edits(p) {
            let back = entry.material.with_microfacet(edit).unwrap().with_microfacet(p).unwrap();
            assert_eq!(back.eval(light, view), entry.material.eval(light, view), "{}", entry.name);
        }
    }
}

#[test]
fn mixes_of_shipped_materials_keep_their_energy() {
    let library = shipped();
    let names = library.names();
    names.par_iter().enumerate().for_each(|(i, a)| {
        let b = &names[(i + 5) % names.len()];
        let [of_a, of_b] = [a, b].map(|name| EditLaw::new(library.material(Some(name)).unwrap()));
        for t in [0.1, 0.5, 0.9] {
            let mix = library.mix(a, b, t).unwrap();
            let worst = worst(&of_a.or(&of_b).findings(&mix));
            assert!(worst <= glimt_check::edits::EDIT_EXCESS, "{a} + {t} {b}: {worst} of what it may have");
        }
    });
}
