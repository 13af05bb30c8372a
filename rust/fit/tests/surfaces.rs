//! Fits of surfaces.

use std::ops::ControlFlow;

use glimt_core::library::Origin;
use glimt_core::models::gated::texture::Disk;
use glimt_core::models::gated::{Angles, Base};
use glimt_core::models::maps::{Filter, Maps, Texel};
use glimt_core::surface::{Layout, Precision, Wrap};
use glimt_core::{Library, Material};
use glimt_fit::Outcome;
use glimt_fit::checkpoint::CheckpointOf;
use glimt_fit::surfaces::errors::{Errors, by_level};
use glimt_fit::surfaces::gated::{Learning, Shape, SquareLoss, Targets, Workspace, block};
use glimt_fit::surfaces::mips::{self, Mips};
use glimt_fit::surfaces::queries::{Drawing, Footprints, Gaussians, Queries, Samples};
use glimt_fit::surfaces::training::{Pace, Training, fold, start, unfold};
use glimt_fit::surfaces::{Surface, SurfaceOptions, fit_surface};
use glimt_fit::train::State;

/// Metal with a relief, and lacquer here and there.
fn maps(width: usize, height: usize) -> Maps {
    let texel = |i: usize| {
        let (x, y) = (i % width, i / width);
        let wave = |k: f32| (k * x as f32 + 1.3 * k * y as f32).sin();
        let is_metal = wave(0.9) > -0.3;
        Texel {
            kd: if is_metal { [0.0; 3] } else { [0.4, 0.1, 0.1] },
            f0: if is_metal { [0.7, 0.6, 0.4] } else { [0.04; 3] },
            alpha: 0.25 + 0.1 * wave(2.1),
            slope: [0.5 * wave(1.7), 0.4 * wave(3.1)],
        }
    };
    Maps::new(width, (0..width * height).map(texel), Wrap::Repeat, Filter::Moments).unwrap()
}

fn options(base: Base, angles: Angles, steps: u64) -> SurfaceOptions {
    let mut options = SurfaceOptions { base, angles, ..SurfaceOptions::standard([16, 16], steps, 7) };
    options.disk = Disk { rings: 8, sectors: 8 };
    options.pace.blocks = 8;
    options
}

fn drawing(maps: &Maps) -> Drawing<'_> {
    Drawing {
        field: maps,
        gaussians: Gaussians::new(4),
        footprints: Footprints::Training { floor: 0.5 },
        seed: 3,
    }
}

/// What a block is compared with.
struct Block {
    queries: Queries,
    f: [glimt_fit::backprop::Row; 3],
    analytic: [glimt_fit::backprop::Row; 3],
}

fn drawn(maps: &Maps, number: u64) -> Block {
    let zero = glimt_fit::backprop::ZERO_ROW;
    let mut block = Block { queries: Queries::default(), f: [zero; 3], analytic: [zero; 3] };
    drawing(maps).block(number, &mut block.queries, &mut block.f, &mut Samples::default());
    let side = |rows: &[glimt_fit::backprop::Row; 3]| rows.each_ref().map(|row| row.as_flattened().to_vec());
    let [light, view] = [side(&block.queries.light), side(&block.queries.view)];
    maps.eval_places(
        &block.queries.places,
        light.each_ref().map(|x| &x[..]),
        view.each_ref().map(|x| &x[..]),
        block.analytic.each_mut().map(|row| row.as_flattened_mut()),
    );
    block
}

#[test]
fn derivatives_are_finite_differences_through_fetch_frames_warps_gate_and_network() {
    let maps = maps(16, 16);
    let Block { queries, f, analytic } = drawn(&maps, 0);
    // The part of the loss that divides by the model's own value is not differentiated by it.
    let loss = SquareLoss { floor: 1e6, absolute: 1.0 };
    /// Of the loss of a block, in float32, over two steps.
    const ROUNDING: f64 = 2e-3;
    for (base, angles) in [
        (Base::Maps, Angles::Matrices),
        (Base::Maps, Angles::Vectors),
        (Base::None, Angles::Matrices),
        (Base::None, Angles::Vectors),
    ] {
        let shape = options(base, angles, 1).shape([16, 16], Wrap::Repeat).unwrap();
        let mut workspace = Workspace::new(&shape);
        let mut numbers = start(&shape, 1);
        // A start is nearly flat, and the derivatives by frames and warps are small beside rounding.
        let textures = shape.places().textures;
        for i in textures[0].start..textures[1].end {
            numbers[i] += 0.3 * (1.7 * i as f32).sin();
        }
        let outputs = shape.network.layer(shape.network.layers() - 1).1;
        let end = numbers.len();
        numbers[end - outputs..].fill(-0.5);
        let targets = Targets { f: &f, analytic: &analytic };
        let mut value = |numbers: &[f32], gradient: &mut [f32]| {
            block(&shape, loss, numbers, &queries, &targets, &mut workspace, gradient)
        };
        let mut gradient = vec![0.0; shape.len()];
        value(&numbers, &mut gradient);
        let places = shape.places();
        let parts = [
            ("latents", places.latents),
            ("half", places.textures[0].clone()),
            ("difference", places.textures[1].clone()),
            ("frames", places.frames),
            ("warps", places.warps),
            ("network", places.network),
        ];
        for (name, part) in parts {
            // Along the gradient itself, where the difference is largest. Between texels the model has kinks.
            let norm = gradient[part.clone()].iter().map(|g| f64::from(g * g)).sum::<f64>().sqrt();
            let step = 0.004;
            let moved = |sign: f64| {
                let mut moved = numbers.clone();
                for i in part.clone() {
                    moved[i] += (sign * step * f64::from(gradient[i]) / norm) as f32;
                }
                moved
            };
            let mut ignored = vec![0.0; shape.len()];
            let difference =
                (value(&moved(1.0), &mut ignored) - value(&moved(-1.0), &mut ignored)) / (2.0 * step);
            assert!(
                (difference - norm).abs() < 0.06 * norm + ROUNDING,
                "{base:?} {angles:?} {name}: {norm} against {difference}"
            );
        }
    }
}

#[test]
fn folding_is_the_transpose_of_unfolding() {
    let layout = Layout::new([7, 5], Wrap::Repeat);
    let n = layout.texels() * 8;
    let wave = |k: f32| (0..n).map(|i| (k * i as f32).sin()).collect::<Vec<f32>>();
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(x * y)).sum::<f64>();
    let (details, gradient) = (wave(0.7), wave(1.9));
    let (mut texels, mut folded) = (details.clone(), gradient.clone());
    unfold(&layout, &mut texels);
    fold(&layout, &mut folded);
    let (a, b) = (dot(&texels, &gradient), dot(&details, &folded));
    assert!((a - b).abs() < 1e-4 * a.abs().max(1.0), "{a} against {b}");
}

#[test]
fn a_small_footprint_sees_its_centre_by_few_samples_or_many() {
    let maps = maps(16, 16);
    let footprints = Footprints::Level(-8.0);
    let drawn = |samples| {
        let drawing = Drawing { footprints, gaussians: Gaussians::new(samples), ..drawing(&maps) };
        let (mut queries, zero) = (Queries::default(), glimt_fit::backprop::ZERO_ROW);
        let mut f = [zero; 3];
        drawing.block(5, &mut queries, &mut f, &mut Samples::default());
        f
    };
    let (few, many) = (drawn(2), drawn(500));
    let (few, many) = (few.as_flattened().as_flattened(), many.as_flattened().as_flattened());
    let difference: f32 = few.iter().zip(many).map(|(a, b)| (a - b).abs()).sum();
    assert!(difference < 0.02 * many.iter().sum::<f32>(), "{difference}");
}

/// The numbers after so many steps, on so many threads.
fn trained(threads: usize, steps: u64) -> Vec<f32> {
    let maps = maps(16, 16);
    let options = options(Base::Maps, Angles::Matrices, 8);
    let shape = options.shape([16, 16], Wrap::Repeat).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut state = State::new(start(&shape, 7));
        let mut training = Training::new(shape, options.pace, &maps, &maps);
        (0..steps).for_each(|_| _ = training.step(&mut state));
        state.numbers
    })
}

#[test]
fn any_number_of_threads_makes_the_same_steps() {
    assert!(trained(1, 4) == trained(3, 4));
}

fn fitted(maps: &Maps, options: &SurfaceOptions) -> Material {
    let origin = Origin { sha256: "abc".into(), ..Origin::default() };
    let surface = Surface { name: "plates".into(), maps, field: maps, origin };
    match fit_surface(&surface, options, None, &mut |_, _| ControlFlow::Continue(())).unwrap() {
        Outcome::Done(entries) => entries[0].material.clone(),
        Outcome::Stopped(_) => panic!("nobody stopped it"),
    }
}

#[test]
fn a_fit_that_was_stopped_goes_on_to_the_same_library() {
    let maps = maps(16, 8);
    let options = options(Base::Maps, Angles::Matrices, 40);
    let origin = Origin { sha256: "abc".into(), ..Origin::default() };
    let surface = Surface { name: "plates".into(), maps: &maps, field: &maps, origin };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("half.checkpoint");
    let stopped = fit_surface(&surface, &options, None, &mut |_, _| ControlFlow::Break(())).unwrap();
    let Outcome::Stopped(Some(checkpoint)) = stopped else { panic!("it was stopped") };
    assert_eq!(checkpoint.state.step, 20);
    checkpoint.save(&path).unwrap();
    let other = SurfaceOptions { latent_size: 3, ..options.clone() };
    let again = CheckpointOf::open(&path).unwrap();
    let refused = fit_surface(&surface, &other, Some(again), &mut |_, _| ControlFlow::Continue(()));
    assert!(refused.err().unwrap().to_string().contains("other options"));
    let again = CheckpointOf::open(&path).unwrap();
    let Outcome::Done(resumed) =
        fit_surface(&surface, &options, Some(again), &mut |_, _| ControlFlow::Continue(())).unwrap()
    else {
        panic!("nobody stopped it")
    };
    let bytes = |entry| Library::new("a", vec![entry]).unwrap().to_bytes().unwrap();
    let mut whole = resumed[0].clone();
    whole.material = fitted(&maps, &options);
    assert!(bytes(resumed[0].clone()) == bytes(whole));
}

/// A short fit is nearer to the truth than the maps at every level but the finest, where they are right; limits are
/// a tenth above what it has.
#[test]
fn a_short_fit_is_far_nearer_than_mip_maps_and_eight_bits_cost_little() {
    let maps = maps(16, 16);
    let averages: Material = maps.filtered(Filter::Average).into();
    let options = options(Base::Maps, Angles::Matrices, 400);
    let rounded = by_level(&maps, &fitted(&maps, &options));
    let exact =
        by_level(&maps, &fitted(&maps, &SurfaceOptions { precision: Precision::F32, ..options.clone() }));
    let before = by_level(&maps, &averages);
    let (rounded, exact, before) = (Errors::mean(&rounded), Errors::mean(&exact), Errors::mean(&before));
    assert!(rounded.log_mae < 0.40 * before.log_mae, "{} of {}", rounded.log_mae, before.log_mae);
    assert!(rounded.log_mae < 1.02 * exact.log_mae, "{} against {}", rounded.log_mae, exact.log_mae);
}

/// Fitted mips are nearer than averaged ones; the limit is a tenth above what they have.
#[test]
fn fitted_mips_are_nearer_than_averages() {
    let maps = maps(16, 16);
    let averages = maps.filtered(Filter::Average);
    let pace = SurfaceOptions::standard([16, 16], 150, 0).pace;
    let pace = Pace { rate: 4e-3, blocks: 8, ..pace };
    let mut state = State::new(mips::start(&averages));
    let mut training = Mips::new(&averages, &maps, pace);
    (0..pace.steps).for_each(|_| _ = training.step(&mut state));
    let fitted: Material = mips::finish(&averages, &state.numbers).unwrap().into();
    let [before, after] =
        [&averages.into(), &fitted].map(|material| Errors::mean(&by_level(&maps, material)));
    assert!(after.log_mae < 0.75 * before.log_mae, "{} of {}", after.log_mae, before.log_mae);
}

#[test]
fn options_that_make_no_surface_are_refused() {
    let standard = SurfaceOptions::standard([64, 32], 10, 0);
    let refused = |options: SurfaceOptions| options.shape([64, 32], Wrap::Repeat).unwrap_err().to_string();
    assert!(refused(SurfaceOptions { latent_size: 65, ..standard.clone() }).contains("expected 1 to 64"));
    let disk = Disk { rings: 1, sectors: 4 };
    assert!(refused(SurfaceOptions { disk, ..standard.clone() }).contains("1 rings"));
    let shape: Shape = standard.shape([64, 32], Wrap::Repeat).unwrap();
    assert_eq!((shape.layout.size(), shape.frames), ([32, 16], Learning::Learned));
}
