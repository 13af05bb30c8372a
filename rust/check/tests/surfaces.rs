//! Surfaces at a place, whose facets are inclined.

use glimt_check::{BrdfSubject, Claims, Options, Report, Test, check};
use glimt_core::Material;
use glimt_core::models::maps::{Filter, Maps, Texel};
use glimt_core::surface::{Place, Wrap};

/// A mirror, a paint and a cloth on slopes of 17° to 66°.
fn surface() -> Material {
    let texel =
        |kd: f32, f0: f32, alpha: f32, slope: [f32; 2]| Texel { kd: [kd; 3], f0: [f0; 3], alpha, slope };
    let texels = [
        texel(0.0, 0.7, 0.08, [0.3, 0.0]),
        texel(0.4, 0.04, 0.3, [-0.5, 0.6]),
        texel(0.6, 0.04, 0.7, [0.9, -2.0]),
    ];
    Maps::new(3, texels, Wrap::Repeat, Filter::Moments).unwrap().into()
}

#[test]
fn steep_facets_are_sampled_as_their_density_says() {
    let material = surface();
    assert!(Claims::of(&material).tilted);
    let places =
        [1.0 / 6.0, 0.5, 5.0 / 6.0].map(|u| Place::point([u, 0.5])).into_iter().chain([Place::far()]);
    let checked = places.map(|place| {
        let brdf = material.at(&place);
        let name = format!("{place:?}");
        check(&BrdfSubject { name, claims: Claims::of(&material), brdf: &brdf }, &Options::SMALL).unwrap()
    });
    let report = Report::new(checked.collect());
    assert!(report.passed(), "{}", report.text());
    // What faces a light at the horizon reflects it, which is no mistake.
    let limits =
        report.subjects.iter().map(|subject| subject.test(Test::HorizonLimit).unwrap().verdict.name());
    assert!(limits.into_iter().all(|verdict| verdict == "figure"));
}
