//! Fits to materials that are hard to fit: they converge, or say why not, and write no NaN. The tables of
//! `docs/notes/stiff-fits.md` come from `examples/stiff`, which runs the same cases for longer.

use glimt_core::library::{Entry, Library};
use glimt_core::microfacet::Microfacet;
use glimt_core::{Brdf, Vec3, is_lit};
use glimt_fit::Model;
use glimt_report::{BrdfError, Protocol};

#[path = "../examples/stiff/cases.rs"]
mod cases;
#[path = "../examples/stiff/condition.rs"]
mod condition;
#[path = "../examples/stiff/eigen.rs"]
mod eigen;

use cases::{Case, Run, cases, models, rate, run};
use condition::gauss_newton;
use eigen::{condition, scaled};

/// Materials besides the one in the crowd.
const CROWD: usize = 6;
const PAIRS: usize = 4000;

/// Log-MAE of fits of 300 steps with `ggx`, `hybrid`, `neural` and `spherical`: the largest that AVX-512, AVX2 and
/// portable kernels were measured to reach. `ggx` knows one lobe and no sheen; the lobe of the range of 1e7 is too
/// narrow for what has no analytic part; of the 448 samples, a network knows nothing between them.
const MEASURED: [(&str, [f64; 4]); 10] = [
    ("easy", [0.03611, 0.00191, 0.00964, 0.00632]),
    ("near mirror", [0.0, 1e-5, 0.00080, 0.00079]),
    ("range of 1e7", [0.01211, 0.01189, 0.01920, 0.01921]),
    ("hot pixel", [0.0, 1e-5, 5e-5, 6e-5]),
    ("black channel", [0.01052, 0.00111, 0.00102, 0.00355]),
    ("black", [0.0; 4]),
    ("constant", [0.0, 1e-5, 0.00015, 0.00021]),
    ("448 samples", [0.03862, 0.00843, 0.07654, 0.07954]),
    ("duplicates", [0.02283, 0.00134, 0.00496, 0.00512]),
    ("one in a crowd", [0.01969, 0.00505, 0.00840, 0.00410]),
];

/// The rounding of another machine.
const ROOM: f64 = 1.1;
/// The last digit of what was measured.
const DIGIT: f64 = 1e-5;

/// Most that a fit of 300 steps may have for a log-MAE.
fn most(case: &Case, model: &Model) -> f64 {
    let (_, figures) = MEASURED.iter().find(|(name, _)| *name == case.name).expect("every case was measured");
    let figure = match model {
        Model::Ggx(_) => figures[0],
        Model::Hybrid(_) => figures[1],
        Model::Neural(_) => figures[2],
        Model::Spherical(_) => figures[3],
    };
    ROOM * figure + DIGIT
}

fn check(case: &Case, model: &Model, run: &Run) {
    let what = format!("{} {model:?}", case.name);
    assert_eq!(run.failure, None, "{what}");
    assert!(run.curve.iter().all(|(_, loss)| loss.is_finite()), "{what}: {:?}", run.curve);
    let (first, last) = (run.curve[0].1, run.curve[run.curve.len() - 1].1);
    assert!(last <= first, "{what}: the loss rose from {first} to {last}");
    assert!(run.worst.is_finite() && run.smape <= 2.0, "{what}: {} and {}", run.worst, run.smape);
    readable(case.name, &run.entries);
}

/// What is written can be read: the reader refuses what is not finite.
fn readable(name: &str, entries: &[Entry]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(format!("{name}.safetensors"));
    Library::new(&path, entries.to_vec()).unwrap().save().unwrap();
    assert_eq!(Library::open(&path).unwrap().entries().unwrap().len(), entries.len());
}

#[test]
fn every_stiff_case_converges_with_every_model() {
    for case in cases(CROWD) {
        for (name, model) in models() {
            let run = run(&case, &model, 300, 1, rate(&model), PAIRS);
            check(&case, &model, &run);
            println!("{} {name}: {:.5}", case.name, run.log_mae);
            assert!(run.log_mae <= most(&case, &model), "{} {name}: {}", case.name, run.log_mae);
        }
    }
}

/// The same f everywhere.
struct Constant(Vec3);

impl Brdf for Constant {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if is_lit(light, view) { self.0 } else { Vec3::ZERO }
    }
}

/// Log-MAE of the constant that comes nearest to a case's first material, which is what a collapsed fit ends in.
fn of_best_constant(case: &Case) -> f64 {
    const LEVELS: i32 = 60;
    let protocol = Protocol::seeded(9, PAIRS);
    let error = |f: Vec3| BrdfError::measure(&*case.materials[0], &Constant(f), &protocol).log_mae;
    let mut best = Vec3::ONE;
    // The error is a mean over channels, so that each can be searched by itself.
    for channel in 0..3 {
        let at = |level: i32| {
            let mut f = best;
            f[channel] = 10_f32.powf(level as f32 / LEVELS as f32 * 4.0 - 3.0);
            f
        };
        best = (0..=LEVELS).map(at).min_by(|&a, &b| error(a).total_cmp(&error(b))).unwrap();
    }
    error(best)
}

#[test]
fn ten_times_and_a_tenth_of_the_rate_still_converge() {
    let case = &cases(CROWD)[0];
    let collapsed = of_best_constant(case);
    // Measured as above. `neural` does not stand ten times its rate, and docs/notes/stiff-fits.md says so.
    for (wanted, factor, figure) in [
        ("hybrid", 10.0, 0.00096),
        ("hybrid", 0.1, 0.03607),
        ("neural", 0.1, 0.03730),
        ("spherical", 10.0, 0.00540),
        ("spherical", 0.1, 0.01548),
    ] {
        let (name, model) = models().into_iter().find(|(name, _)| *name == wanted).unwrap();
        let run = run(case, &model, 300, 1, factor * rate(&model), PAIRS);
        assert_eq!(run.failure, None);
        let error = run.log_mae;
        println!("{name} at {factor} times its rate: {error:.5}, collapsed {collapsed:.5}");
        assert!(error <= ROOM * figure + DIGIT, "{name} at {factor} times its rate: {error}");
        // The test of the limit: a collapsed fit is beyond it.
        assert!(ROOM * figure + DIGIT < 0.5 * collapsed);
    }
}

#[test]
fn an_absurd_rate_is_an_error_or_a_finite_library() {
    for case in &cases(CROWD)[..3] {
        for (_, model) in &models()[1..] {
            let run = run(case, model, 100, 1, 1e6, PAIRS);
            match &run.failure {
                Some(failure) => {
                    assert!(failure.contains("diverged") && failure.contains("--rate"), "{failure}")
                }
                None => readable(case.name, &run.entries),
            }
        }
    }
}

/// Adam scales each number by itself; what that leaves must not be what makes a fit fail.
#[test]
fn scaling_each_number_makes_the_analytic_hessian_tame() {
    for (kd, eta, alpha, most) in
        [(0.2, 1.5, 0.3, 100.0), (0.2, 1.5, 0.01, 100.0), (0.02, 1.5, 1e-3, 1000.0), (0.2, 8.0, 0.3, 1000.0)]
    {
        let hessian = gauss_newton(&Microfacet { kd: [kd; 3], eta: [eta; 3], alpha: [alpha; 2] });
        let (plain, scaled) = (condition(&hessian), condition(&scaled(&hessian)));
        assert!(
            scaled < plain && scaled < most,
            "k_d {kd}, eta {eta}, alpha {alpha}: {plain}, scaled {scaled}"
        );
    }
}

/// A metal whose lobe is a tenth as wide as any other, in a network that has a hundred cloths to learn.
#[test]
#[ignore = "long: a hundred and one materials, three models"]
fn one_metal_against_a_hundred_cloths_keeps_its_lobe() {
    let case = cases(100).pop().unwrap();
    assert_eq!((case.name, case.materials.len()), ("one in a crowd", 101));
    for (name, model) in models() {
        let run = run(&case, &model, 1000, 1, rate(&model), PAIRS);
        check(&case, &model, &run);
        let metal = &run.entries[100].material;
        let error = BrdfError::measure(&*case.materials[100], metal, &Protocol::seeded(9, PAIRS)).log_mae;
        println!("{name}: log-MAE {:.5} over all, {error:.5} of the metal", run.log_mae);
        if let Some(microfacet) = metal.microfacet() {
            assert!((microfacet.alpha[0] / 0.03 - 1.0).abs() < 0.05, "{name}: alpha {}", microfacet.alpha[0]);
            assert!(error < 0.02, "{name}: the metal's log-MAE is {error}");
        }
    }
}

#[test]
#[ignore = "long: every case with every model and eight seeds"]
fn seeds_agree_on_every_stiff_case() {
    for case in cases(100) {
        for (_, model) in models() {
            let runs = (1..=8).map(|seed| run(&case, &model, 2000, seed, rate(&model), PAIRS));
            let mut errors: Vec<f64> = runs
                .map(|run| {
                    check(&case, &model, &run);
                    run.log_mae
                })
                .collect();
            errors.sort_by(f64::total_cmp);
            let spread = errors[7] / errors[4].max(1e-4);
            assert!(spread < 3.0, "{} {model:?}: {errors:?}", case.name);
        }
    }
}
