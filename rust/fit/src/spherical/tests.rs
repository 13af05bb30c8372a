use super::*;
use crate::fit::{Input, Outcome, fit};
use crate::options::{Model, Net, Options, SPHERICAL_LOSS, SphericalOptions};
use crate::pairs::{self, Drawing};
use crate::train::{Schedule, State};
use crate::truth::Truth;
use glam::Vec3;
use glimt_core::library::Origin;
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::models::spherical::pixelation::Pixelation;
use glimt_core::models::spherical::tables::{Form, Grids, Interpolation};
use glimt_core::{AnyModel, Brdf, Material};
use std::ops::ControlFlow;

const GRIDS: [Grids; 3] = [Grids::Lv, Grids::Hd, Grids::Iso];

fn form(grids: Grids) -> Form {
    Form {
        grids,
        pixelation: Pixelation::Healpix,
        nside: 2u16.try_into().unwrap(),
        nodes: 6,
        features: 4,
        interpolation: Interpolation::Bilinear,
    }
}

fn material(alpha: [f32; 2]) -> Ggx {
    Ggx::new(Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha }).unwrap()
}

/// Every kind of number, against differences of the loss itself. While primitives are chosen, the loss is a step
/// function of the features; see `derivatives_pass_the_choice_of_primitives`.
#[test]
fn gradient_is_the_finite_difference_for_network_features_and_primitives() {
    let squared = Loss { absolute: 0.0, squared: 1.0, relative: 0.0 };
    let target = material([0.3, 0.4]);
    for grids in GRIDS {
        for (store, stage) in [(StoreKind::F32, Stage::Free), (StoreKind::Codebook(3), Stage::Chosen)] {
            let layout = Layout::new(form(grids)).unwrap();
            let shape = Shape::new(layout.form().inputs(), &[16, 16], 3, SphericalObjective::ACTIVATION);
            let rows = layout.places().len();
            let objective = SphericalObjective { layout: &layout, rows, shape, loss: squared, store, stage };
            let mut state = State::new(objective.initial(5, 1));
            let (network, shared) = (objective.shape.len(), objective.shared_len());
            let features = shared..shared + layout.places().len() * 4;
            if stage == Stage::Chosen {
                objective.make_codebook(&mut state, 1);
            }
            let numbers = state.numbers;
            let pairs = &pairs::draw(Drawing::Lobes, 3, 1, 1)[0];
            let target = &pairs::evaluate(&target, std::slice::from_ref(pairs))[0];
            let mut workspace = objective.workspace();
            let mut evaluate = |numbers: &[f32]| {
                let (own_shared, own) = numbers.split_at(shared);
                let mut gradient = vec![0.0; numbers.len()];
                let (by_shared, by_own) = gradient.split_at_mut(shared);
                let loss = objective.block(&mut workspace, own_shared, own, pairs, target, by_shared, by_own);
                (loss, gradient)
            };
            let (_, gradient) = evaluate(&numbers);
            let kinds: Vec<(&str, std::ops::Range<usize>, usize)> = match stage {
                Stage::Chosen => vec![("primitive", network..shared, 1)],
                _ => vec![("network", 0..network, 7), ("feature", features.clone(), 3)],
            };
            for (kind, range, step) in kinds {
                let largest = gradient[range.clone()].iter().fold(0.0f32, |a, g| a.max(g.abs()));
                assert!(largest > 1e-3, "{grids:?}: {kind} has no derivative");
                for n in range.step_by(step) {
                    const STEP: f32 = 4e-3;
                    let mut shifted = numbers.clone();
                    shifted[n] += STEP;
                    let above = evaluate(&shifted).0;
                    shifted[n] -= 2.0 * STEP;
                    let slope = (above - evaluate(&shifted).0) / f64::from(2.0 * STEP);
                    let error = (f64::from(gradient[n]) - slope).abs();
                    assert!(
                        error < 0.02 * slope.abs() + 5e-3 * f64::from(largest),
                        "{grids:?} {kind} {n}: {} against {slope}",
                        gradient[n]
                    );
                }
            }
            if stage == Stage::Chosen {
                assert!(gradient[features].iter().all(|&g| g == 0.0), "chosen features move no more");
            }
        }
    }
}

/// A turn and a codebook with a primitive for every row make the same of every pair as the features did.
#[test]
fn features_turn_into_primitives_without_a_change_of_the_model() {
    let loss = SPHERICAL_LOSS;
    let target = material([0.3, 0.4]);
    let pairs = &pairs::draw(Drawing::Lobes, 3, 1, 1)[0];
    let target = &pairs::evaluate(&target, std::slice::from_ref(pairs))[0];
    for grids in GRIDS {
        let layout = Layout::new(form(grids)).unwrap();
        let rows = layout.places().len();
        let shape = Shape::new(layout.form().inputs(), &[16, 16], 3, SphericalObjective::ACTIVATION);
        let store = StoreKind::Codebook(8);
        let mut objective =
            SphericalObjective { layout: &layout, rows, shape, loss, store, stage: Stage::Free };
        let mut state = State::new(objective.initial(5, 2));
        let values = |objective: &SphericalObjective, state: &State| -> Vec<f64> {
            let (shared, own) = state.numbers.split_at(objective.shared_len());
            let (mut by_shared, mut by_own) = (vec![0.0; shared.len()], vec![0.0; objective.own_len()]);
            let workspace = &mut objective.workspace();
            own.chunks_exact(objective.own_len())
                .map(|own| {
                    objective.block(workspace, shared, own, pairs, target, &mut by_shared, &mut by_own)
                })
                .collect()
        };
        let before = values(&objective, &state);
        assert!(2 * rows <= 256, "{rows} rows of either material have no primitive each");
        objective.make_codebook(&mut state, 1);
        let turned = values(&objective, &state);
        objective.stage = Stage::Choosing;
        let chosen = values(&objective, &state);
        for ((a, b), c) in before.iter().zip(turned).zip(chosen) {
            assert!((a - b).abs() < 1e-3 * a && (a - c).abs() < 1e-3 * a, "{grids:?}: {a}, {b}, {c}");
        }
    }
}

/// While primitives are chosen, features have the derivatives that they would have if they stood for
/// themselves where their primitives are.
#[test]
fn derivatives_pass_the_choice_of_primitives() {
    let target = material([0.3, 0.4]);
    let layout = Layout::new(form(Grids::Hd)).unwrap();
    let rows = layout.places().len();
    let shape = Shape::new(layout.form().inputs(), &[16, 16], 3, SphericalObjective::ACTIVATION);
    let (loss, store, stage) = (SPHERICAL_LOSS, StoreKind::Codebook(3), Stage::Choosing);
    let mut objective = SphericalObjective { layout: &layout, rows, shape, loss, store, stage };
    let mut state = State::new(objective.initial(5, 1));
    objective.make_codebook(&mut state, 1);
    let pairs = &pairs::draw(Drawing::Lobes, 3, 1, 1)[0];
    let target = &pairs::evaluate(&target, std::slice::from_ref(pairs))[0];
    let derivatives = |objective: &SphericalObjective, numbers: &[f32]| {
        let shared = objective.shared_len();
        let mut gradient = vec![0.0; numbers.len()];
        let (by_shared, by_own) = gradient.split_at_mut(shared);
        let (of_shared, own) = numbers.split_at(shared);
        objective.block(&mut objective.workspace(), of_shared, own, pairs, target, by_shared, by_own);
        gradient
    };
    let chosen = derivatives(&objective, &state.numbers);
    let (features, primitives) = (
        objective.shared_len()..objective.shared_len() + rows * 4,
        objective.shape.len()..objective.shared_len(),
    );
    let mut sums = vec![0.0; primitives.len()];
    for row in 0..rows {
        let choice = state.numbers[features.end + row] as usize * 4;
        for j in 0..4 {
            state.numbers[features.start + row * 4 + j] = state.numbers[primitives.start + choice + j];
            sums[choice + j] += chosen[features.start + row * 4 + j];
        }
    }
    objective.stage = Stage::Free;
    let free = derivatives(&objective, &state.numbers);
    assert_eq!(chosen[features.clone()], free[features]);
    for (sum, derivative) in sums.iter().zip(&chosen[primitives]) {
        assert!((sum - derivative).abs() < 1e-3 * derivative.abs().max(0.01), "{sum}, not {derivative}");
    }
}

fn options(grids: Grids, store: StoreKind, steps: u64) -> Options {
    let form = Form { nside: 8u16.try_into().unwrap(), nodes: 24, features: 8, ..form(grids) };
    let net = Net { width: 16, layers: 2 };
    let spherical = SphericalOptions { form, store, net, clusters: None, loss: SPHERICAL_LOSS };
    let schedule = Schedule { blocks: 2, rate: 0.02, ..Schedule::standard(steps, 1) };
    Options { model: Model::Spherical(spherical), schedule }
}

fn input<'a>(name: &str, truth: Truth<'a>) -> Input<'a> {
    Input { name: name.to_owned(), truth, isotropic: true, origin: Origin::default() }
}

/// Mean of |ln(1 + f cosθ) − ln(1 + f̂ cosθ)|.
fn log_error(model: &dyn Brdf, truth: &dyn Brdf) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for pairs in pairs::draw(Drawing::Cosine, 77, 0, 8) {
        for column in 0..COLUMNS {
            let (light, view) = (lanes(&pairs.light, column), lanes(&pairs.view, column));
            let (mut f, mut g) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
            truth.eval_tile(&light, &view, &mut f);
            model.eval_tile(&light, &view, &mut g);
            for c in 0..3 {
                for lane in 0..LANES {
                    let log = |f: f32| (1.0 + f * light[2][lane]).ln();
                    sum += (log(f[c][lane]) - log(g[c][lane])).abs();
                    count += 1.0;
                }
            }
        }
    }
    sum / count
}

fn fitted(inputs: &[Input], options: &Options) -> Vec<Material> {
    let Ok(Outcome::Done(entries)) = fit(inputs, options, None, &mut |_, _| ControlFlow::Continue(())) else {
        panic!("the fit did not end")
    };
    entries.into_iter().map(|entry| entry.material).collect()
}

#[test]
fn every_kind_of_grid_and_store_comes_near_its_material() {
    let truth = material([0.3; 2]);
    for (grids, store, limit) in [
        (Grids::Iso, StoreKind::F32, 0.004),
        (Grids::Iso, StoreKind::I8, 0.004),
        (Grids::Iso, StoreKind::I4, 0.008),
        (Grids::Iso, StoreKind::Codebook(6), 0.008),
        (Grids::Hd, StoreKind::I8, 0.008),
        (Grids::Lv, StoreKind::I8, 0.03),
    ] {
        let model = fitted(&[input("a", Truth::Brdf(&truth))], &options(grids, store, 1000)).remove(0);
        let error = log_error(&model, &truth);
        assert!(error < limit, "{grids:?} {store:?}: {error}");
    }
}

/// 0 where light and view are more than 60° apart, as in measurements whose noise is clamped.
struct Clamped;

impl Brdf for Clamped {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if glimt_core::is_lit(light, view) {
            Vec3::splat((light.dot(view) - 0.5).max(0.0))
        } else {
            Vec3::ZERO
        }
    }
}

#[test]
fn what_is_0_is_fitted_as_0() {
    let model = fitted(&[input("clamped", Truth::Brdf(&Clamped))], &options(Grids::Iso, StoreKind::I8, 1000))
        .remove(0);
    let (mut dark, mut wrong) = (0, 0);
    for i in 0..4000u32 {
        let direction = |a: f32, b: f32| {
            let (z, phi) = (0.05 + 0.95 * (i as f32 * a).fract(), i as f32 * b);
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        };
        let (light, view) = (direction(0.754_877_7, 2.399), direction(0.569_840_3, 1.117));
        if light.dot(view) < 0.5 {
            dark += 1;
            wrong += i32::from(model.eval(light, view) != Vec3::ZERO);
        }
    }
    assert!(dark > 1000 && wrong * 10 < dark, "{wrong} of {dark} dark pairs are not");
}

#[test]
fn a_fit_that_was_interrupted_in_any_stage_ends_the_same() {
    let truths = [material([0.3; 2]), material([0.15; 2])];
    let inputs = [input("a", Truth::Brdf(&truths[0])), input("b", Truth::Brdf(&truths[1]))];
    for store in [StoreKind::I8, StoreKind::Codebook(4)] {
        let options = options(Grids::Iso, store, 1000);
        let whole = fitted(&inputs, &options);
        let mut checkpoint = None;
        let mut stops = 0;
        let parts = loop {
            let mut calls = 0;
            let end = fit(&inputs, &options, checkpoint.take(), &mut |_, _| {
                calls += 1;
                if calls > 8 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            });
            match end.unwrap() {
                Outcome::Done(entries) => break entries,
                Outcome::Stopped(stopped) => checkpoint = stopped,
            }
            stops += 1;
        };
        assert!(stops >= 4);
        let (l, v) = (Vec3::new(0.48, 0.6, 0.64), Vec3::new(-0.6, 0.0, 0.8));
        for (a, b) in whole.iter().zip(parts) {
            assert_eq!(a.eval(l, v), b.material.eval(l, v), "{store:?}");
        }
    }
}

#[test]
fn clusters_hold_what_is_alike_and_share_network_and_codebook() {
    let truths = [[0.3; 2], [0.05; 2], [0.31; 2], [0.052; 2]].map(material);
    let inputs: Vec<Input> =
        truths.iter().enumerate().map(|(i, truth)| input(&i.to_string(), Truth::Brdf(truth))).collect();
    let mut options = options(Grids::Iso, StoreKind::Codebook(5), 250);
    let Model::Spherical(spherical) = &mut options.model else { unreachable!() };
    spherical.clusters = Some(2);
    let made = fitted(&inputs, &options);
    let network = |i: usize| std::ptr::from_ref(made[i].network().unwrap());
    assert_eq!(network(0), network(2));
    assert_eq!(network(1), network(3));
    assert_ne!(network(0), network(1));
    let Model::Spherical(spherical) = &mut options.model else { unreachable!() };
    spherical.clusters = Some(5);
    let Err(error) = fit(&inputs, &options, None, &mut |_, _| ControlFlow::Continue(())) else { panic!() };
    assert!(error.to_string().contains("5 clusters of 4 materials; expected 1 to 4"), "{error}");
}

#[test]
fn anisotropic_materials_refuse_isotropic_grids() {
    let truth = material([0.1, 0.4]);
    let inputs = [Input { isotropic: false, ..input("brushed", Truth::Brdf(&truth)) }];
    let options = options(Grids::Iso, StoreKind::I8, 10);
    let Err(error) = fit(&inputs, &options, None, &mut |_, _| ControlFlow::Continue(())) else { panic!() };
    assert!(error.to_string().contains("\"brushed\" is anisotropic"), "{error}");
}

/// As many samples as the paper's sparsest measurements have.
#[test]
fn a_fit_to_448_samples_is_finite_smooth_and_near_them() {
    let truth = material([0.4; 2]);
    let direction = |i: usize, step: f32| {
        let (z, phi) = (0.1 + 0.9 * ((i as f32 + 0.5) * step).fract(), i as f32 * 2.399 * step);
        let r = (1.0 - z * z).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    };
    let light: Vec<Vec3> = (0..448).map(|i| direction(i, 0.754_877_7)).collect();
    let view: Vec<Vec3> = (0..448).map(|i| direction(i, 0.569_840_3)).collect();
    let f: Vec<Vec3> = light.iter().zip(&view).map(|(&l, &v)| truth.eval(l, v)).collect();
    let inputs = [input("sparse", Truth::Samples { light: &light, view: &view, f: &f })];
    for grids in GRIDS {
        let model = fitted(&inputs, &options(grids, StoreKind::I8, 500)).remove(0);
        let AnyModel::Spherical(spherical) = model.model() else { panic!("another model") };
        assert!(spherical.features().links.is_some(), "{grids:?}: nothing was pruned");
        let at_samples = light.iter().zip(&view).zip(&f).map(|((&l, &v), f)| {
            let error = (model.eval(l, v) - *f).abs() / (*f + 0.01);
            error.element_sum() / 3.0
        });
        let mean = at_samples.sum::<f32>() / 448.0;
        assert!(mean < 0.2, "{grids:?}: {mean} at the samples");
        let brightest = f.iter().fold(0.0f32, |a, f| a.max(f.max_element()));
        for i in 0..2000 {
            let (l, v) = (direction(i, 0.331), direction(i, 0.717));
            let here = model.eval(l, v);
            assert!(here.is_finite() && here.max_element() < 4.0 * brightest, "{grids:?}: {here}");
            let near = model.eval((l + Vec3::new(0.0, 1e-3, 0.0)).normalize(), v);
            assert!(
                (near - here).abs().max_element() < 0.1 * here.max_element() + 0.01,
                "{grids:?}: {here} {near}"
            );
        }
    }
}
