//! BSDFs that are broken in one way each: every one is caught, and this says by which tests.
//!
//! `cargo test -p glimt-check --test mutants -- --nocapture` prints the table of docs/check.md.

use std::f32::consts::{FRAC_1_PI, TAU};
use std::sync::atomic::{AtomicU32, Ordering};

use glam::Vec3;
use glimt_check::{Answer, Claims, Component, Draw, Options, Part, Report, Subject, Test, Verdict, check};
use glimt_core::is_lit;
use glimt_core::microfacet::Microfacet;
use glimt_core::sampling::lobes::{COSINE, GGX_LOBES, KNOTS, Lobes, VisibleNormals};

/// One way to be broken.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Bug {
    None,
    WeightTooLarge,
    WeightWithoutCosine,
    WeightWithoutPdf,
    WeightClamped,
    WeightWrongAtGrazing,
    WeightLost,
    PdfTooLarge,
    PdfMissesTerm,
    PdfSwapped,
    PdfOfHalfVector,
    PdfOfOtherShare,
    PdfOfSampleStale,
    PdfZeroInHalf,
    CosineForgotten,
    EvalSwapped,
    EvalPdfStale,
    NanAtMirror,
    NanAtNormal,
    NanForZero,
    NegativeAtGrazing,
    LobeBelowHorizon,
    SampleBelowHorizon,
    SampleNotDeterministic,
    SampleNotUnit,
    SampleMissesLobe,
    SampleMissesHalf,
    SampleReusesNumber,
    ComponentsDoNotAddUp,
    ComponentPdfWrong,
    ComponentSampleIgnored,
    NotReciprocal,
    NotIsotropic,
    NotConserving,
}

/// The part of a microfacet BRDF that a mutant changes.
const DIFFUSE: usize = 0;
const GLOSSY: usize = 1;

/// Probability of the glossy component.
const GLOSSY_SHARE: f32 = 0.5;

/// A GGX lobe with this probability, and a cosine lobe with the rest.
fn lobes(alpha: [f32; 2], share: f32) -> Lobes {
    let mut shares = [0.0; GGX_LOBES + 1];
    (shares[0], shares[COSINE]) = (share, 1.0 - share);
    Lobes::new([alpha; GGX_LOBES], [shares; KNOTS])
}

/// A diffuse and a glossy component with every claim, and a bug.
struct Mutant {
    bug: Bug,
    material: Microfacet,
    calls: AtomicU32,
}

impl Mutant {
    fn new(bug: Bug) -> Mutant {
        let material = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.8, 1.7, 1.6], alpha: [0.2; 2] };
        Mutant { bug, material, calls: AtomicU32::new(0) }
    }

    /// Density of the glossy lobe.
    fn glossy_pdf(&self, light: Vec3, view: Vec3) -> f32 {
        VisibleNormals { alpha: self.material.alpha }.pdf(light, view)
    }

    /// f of one part.
    fn f(&self, part: Part, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        let (light, view) = if self.bug == Bug::EvalSwapped { (view, light) } else { (light, view) };
        let whole = Vec3::from(self.material.eval(light.into(), view.into()));
        let diffuse = Vec3::from(self.material.kd) * FRAC_1_PI;
        match part {
            Part::Whole => whole,
            Part::Component(DIFFUSE) if self.bug == Bug::ComponentsDoNotAddUp => 0.9 * diffuse,
            Part::Component(DIFFUSE) => diffuse,
            Part::Component(_) => (whole - diffuse).max(Vec3::ZERO),
        }
    }

    fn one_response(&self, part: Part, light: Vec3, view: Vec3) -> Vec3 {
        let is_down = light.z < 0.0 && view.z > 0.0;
        if self.bug == Bug::LobeBelowHorizon && is_down {
            return Vec3::splat(0.05);
        }
        let f = self.f(part, light, view);
        let cosine = match self.bug {
            Bug::CosineForgotten => 1.0,
            Bug::EvalSwapped => view.z.abs(),
            _ => light.z.abs(),
        };
        let azimuth = light.y.atan2(light.x);
        let factor = match self.bug {
            Bug::NanAtMirror if (light + view).truncate().length() < 1e-6 => f32::NAN,
            Bug::NanAtNormal if view.z > 1.0 - 1e-7 => f32::NAN,
            Bug::NegativeAtGrazing if light.z < 0.02 => -1.0,
            Bug::NotReciprocal => 0.5 + 0.5 * light.z,
            Bug::NotIsotropic => 1.0 + 0.3 * (2.0 * azimuth).cos(),
            Bug::NotConserving => 3.0,
            _ => 1.0,
        };
        f * cosine * factor
    }

    fn one_pdf(&self, part: Part, light: Vec3, view: Vec3) -> f32 {
        if !is_lit(light, view) {
            return 0.0;
        }
        let (light, view) = if self.bug == Bug::PdfSwapped { (view, light) } else { (light, view) };
        let half = (light + view).normalize();
        let glossy = match self.bug {
            Bug::PdfOfHalfVector => self.glossy_pdf(light, view) * 4.0 * half.dot(view),
            _ => self.glossy_pdf(light, view),
        };
        let diffuse = light.z * FRAC_1_PI;
        let share = if self.bug == Bug::PdfOfOtherShare { 0.6 } else { GLOSSY_SHARE };
        let pdf = match part {
            Part::Component(DIFFUSE) if self.bug == Bug::ComponentPdfWrong => FRAC_1_PI / 2.0,
            Part::Component(DIFFUSE) => diffuse,
            Part::Component(_) => glossy,
            Part::Whole => (1.0 - share) * diffuse + share * glossy,
        };
        match self.bug {
            Bug::PdfTooLarge => 1.02 * pdf,
            Bug::PdfMissesTerm => (1.0 - share) * diffuse,
            Bug::PdfZeroInHalf if light.y < 0.0 => 0.0,
            _ => pdf,
        }
    }

    fn one_sample(&self, part: Part, view: Vec3, mut u: Vec3) -> Draw {
        let failed = Draw { light: Vec3::Z, pdf: 0.0, weight: Vec3::ZERO, delta: false, eta: 1.0 };
        if self.bug == Bug::NanForZero && u == Vec3::ZERO {
            return Draw { pdf: f32::NAN, ..failed };
        }
        if self.bug == Bug::SampleNotDeterministic {
            u.y = (u.y + 1e-3 * self.calls.fetch_add(1, Ordering::Relaxed) as f32).fract();
        }
        if self.bug == Bug::SampleReusesNumber {
            u.y = u.x;
        }
        let part = if self.bug == Bug::ComponentSampleIgnored { Part::Whole } else { part };
        let share = match (part, self.bug) {
            (Part::Component(DIFFUSE), _) | (_, Bug::SampleMissesLobe) => 0.0,
            (Part::Component(GLOSSY), _) => 1.0,
            _ => GLOSSY_SHARE,
        };
        let Some((mut light, _)) = lobes(self.material.alpha, share).sample_direction(view, u) else {
            return failed;
        };
        if self.bug == Bug::SampleMissesHalf || self.bug == Bug::PdfZeroInHalf {
            light.y = light.y.abs();
        }
        if self.bug == Bug::SampleBelowHorizon && u.z < 0.05 {
            light.z = -light.z;
        }
        let mut pdf = self.one_pdf(part, light, view);
        // The sampler and its density agree on half of the directions only.
        if self.bug == Bug::PdfZeroInHalf {
            pdf = self.one_pdf(part, light, view) * 2.0;
        }
        let response = self.one_response(part, light, view);
        let mut weight = if pdf > 0.0 { response / pdf } else { Vec3::ZERO };
        weight = match self.bug {
            Bug::WeightTooLarge => 1.05 * weight,
            Bug::WeightWithoutCosine => weight / light.z,
            Bug::WeightWithoutPdf => weight * pdf,
            Bug::WeightClamped => weight.min(Vec3::splat(0.3)),
            Bug::WeightWrongAtGrazing if view.z < 0.2 => 1.2 * weight,
            Bug::WeightLost if u.z < 0.05 => Vec3::ZERO,
            Bug::PdfOfSampleStale => response / (1.1 * pdf),
            _ => weight,
        };
        match self.bug {
            Bug::PdfOfSampleStale => pdf *= 1.1,
            Bug::SampleNotUnit => light *= 1.01,
            Bug::SampleBelowHorizon if light.z < 0.0 => (pdf, weight) = (0.1, Vec3::splat(0.5)),
            _ => {}
        }
        Draw { light, pdf, weight, ..failed }
    }
}

impl Subject for Mutant {
    fn name(&self) -> String {
        format!("{:?}", self.bug)
    }

    fn claims(&self) -> Claims {
        Claims { reciprocal: true, isotropic: true, conserving: true, ..Claims::NONE }
    }

    fn components(&self) -> Vec<Component> {
        ["diffuse", "glossy"].map(|name| Component { name: name.into(), delta: false }).into()
    }

    fn response(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<Vec3>> {
        Ok(light.iter().zip(view).map(|(&light, &view)| self.one_response(part, light, view)).collect())
    }

    fn pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<f32>> {
        Ok(light.iter().zip(view).map(|(&light, &view)| self.one_pdf(part, light, view)).collect())
    }

    fn response_and_pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<(Vec<Vec3>, Vec<f32>)> {
        let (response, mut pdf) = (self.response(part, light, view)?, self.pdf(part, light, view)?);
        if self.bug == Bug::EvalPdfStale {
            // A copy of the formula that lost its cosine lobe.
            pdf.iter_mut().zip(light.iter().zip(view)).for_each(|(pdf, (&light, &view))| {
                if *pdf > 0.0 {
                    *pdf = self.glossy_pdf(light, view);
                }
            });
        }
        Ok((response, pdf))
    }

    fn sample(&self, part: Part, view: &[Vec3], u: &[Vec3]) -> Answer<Vec<Draw>> {
        Ok(view.iter().zip(u).map(|(&view, &u)| self.one_sample(part, view, u)).collect())
    }
}

/// Every bug and the test that must catch it, whatever others do.
const CAUGHT_BY: [(Bug, Test); 33] = [
    (Bug::WeightTooLarge, Test::Weight),
    (Bug::WeightWithoutCosine, Test::Weight),
    (Bug::WeightWithoutPdf, Test::Weight),
    (Bug::WeightClamped, Test::Weight),
    (Bug::WeightWrongAtGrazing, Test::Weight),
    (Bug::WeightLost, Test::PdfIntegral),
    (Bug::PdfTooLarge, Test::PdfIntegral),
    (Bug::PdfMissesTerm, Test::ChiSquared),
    (Bug::PdfSwapped, Test::ChiSquared),
    (Bug::PdfOfHalfVector, Test::ChiSquared),
    (Bug::PdfOfOtherShare, Test::ChiSquared),
    (Bug::PdfOfSampleStale, Test::PdfOfSample),
    (Bug::PdfZeroInHalf, Test::Unbiased),
    (Bug::CosineForgotten, Test::HorizonLimit),
    (Bug::EvalSwapped, Test::HorizonLimit),
    (Bug::EvalPdfStale, Test::EvalPdf),
    (Bug::NanAtMirror, Test::Finite),
    (Bug::NanAtNormal, Test::Finite),
    (Bug::NanForZero, Test::Finite),
    (Bug::NegativeAtGrazing, Test::NonNegative),
    (Bug::LobeBelowHorizon, Test::Horizon),
    (Bug::SampleBelowHorizon, Test::Horizon),
    (Bug::SampleNotDeterministic, Test::Deterministic),
    (Bug::SampleNotUnit, Test::UnitLength),
    (Bug::SampleMissesLobe, Test::ChiSquared),
    (Bug::SampleMissesHalf, Test::ChiSquared),
    (Bug::SampleReusesNumber, Test::ChiSquared),
    (Bug::ComponentsDoNotAddUp, Test::ComponentsEval),
    (Bug::ComponentPdfWrong, Test::ChiSquared),
    (Bug::ComponentSampleIgnored, Test::ChiSquared),
    (Bug::NotReciprocal, Test::Reciprocity),
    (Bug::NotIsotropic, Test::Isotropy),
    (Bug::NotConserving, Test::Energy),
];

const OPTIONS: Options = Options { samples: 40_000, ..Options::SMALL };

fn judge(bug: Bug) -> Report {
    Report::new(vec![check(&Mutant::new(bug), &OPTIONS).expect("mutants answer")])
}

#[test]
fn the_subject_without_a_bug_passes_with_every_claim() {
    let report = judge(Bug::None);
    assert_eq!(report.verdict, Verdict::Pass, "{}", report.text());
}

#[test]
fn every_bug_is_caught_by_its_test() {
    let mut missed = Vec::new();
    println!("| bug | caught by |\n|---|---|");
    for (bug, test) in CAUGHT_BY {
        let report = judge(bug);
        let failed: Vec<Test> = report.subjects[0]
            .tests
            .iter()
            .filter(|summary| summary.verdict == Verdict::Fail)
            .map(|summary| summary.test)
            .collect();
        let names: Vec<&str> = failed.iter().map(|test| test.name()).collect();
        println!("| {bug:?} | {} |", names.join(", "));
        if !failed.contains(&test) {
            missed.push((bug, test));
        }
    }
    assert!(missed.is_empty(), "{missed:?}");
}

#[test]
fn false_alarms_are_as_rare_as_promised() {
    // 30 correct runs at a significance of 0.01 fail 0.3 times; 4 or more would be one chance in 7000.
    let material = Mutant::new(Bug::None);
    let failed = (0..30).filter(|&seed| {
        let options = Options { seed, samples: 5_000, ..OPTIONS };
        !Report::new(vec![check(&material, &options).expect("it answers")]).passed()
    });
    assert!(failed.count() < 4);
}

/// A turn of the golden angle leaves an isotropic mutant as it was: the test of the tests above.
#[test]
fn directions_are_as_the_mutants_expect() {
    let mutant = Mutant::new(Bug::None);
    let (light, view) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.6, 0.8));
    let turn = |v: Vec3| glam::Quat::from_rotation_z(0.1 * TAU) * v;
    let (a, b) = (mutant.f(Part::Whole, light, view), mutant.f(Part::Whole, turn(light), turn(view)));
    assert!((a - b).abs().max_element() < 1e-5 * a.max_element());
}
