//! Objectives whose gradient is sparse, on a latent texture with mip levels: a small network sees what is
//! interpolated between texels and between levels.

use std::ops::ControlFlow;

use glam::Vec3;
use glimt_core::kernels::network::Activation;
use glimt_core::simd::LANES;
use glimt_core::{Brdf, is_lit};
use glimt_fit::backprop::{COLUMNS, Row, Shape, Workspace, ZERO_ROW, backward, forward, sum_row};
use glimt_fit::checkpoint::Checkpoint;
use glimt_fit::ggx::loss_rows;
use glimt_fit::gradient::{Gradient, Table};
use glimt_fit::loss::{DEFAULT_LOSS, Loss};
use glimt_fit::objective::Objective;
use glimt_fit::pairs::{Drawing, PairBlock, TargetBlock, draw, evaluate};
use glimt_fit::train::{End, Schedule, State, train};
use glimt_fit::{GgxOptions, Model, Options, Truth};

/// Numbers of a texel.
const WIDTH: usize = 4;
/// Numbers that a material has besides its texture; the network sees them, too.
const CODE: usize = 2;

/// Two levels, the finer of `side` × `side` texels. Shared numbers are the network's; a material's own are its code,
/// then its texels, finer level first.
#[derive(Clone)]
struct Texture {
    side: usize,
    shape: Shape,
    loss: Loss,
}

impl Texture {
    fn new(side: usize, loss: Loss) -> Texture {
        Texture { side, shape: Shape::new(WIDTH + CODE, &[16, 16], 3, Activation::HardGelu), loss }
    }

    /// The eight texels of a pair and their weights: the light says where, and its height between which levels.
    fn taps(&self, light: [f32; 3], view: [f32; 3]) -> [(usize, f32); 8] {
        let mut taps = [(0, 0.0); 8];
        for (level, share) in [light[2], 1.0 - light[2]].into_iter().enumerate() {
            let side = self.side >> level;
            let first = if level == 0 { 0 } else { self.side * self.side };
            let [x, y] = [light[0], view[1]].map(|at| (0.5 * at + 0.5) * side as f32);
            let texel = |x: f32, y: f32| first + y as usize % side * side + x as usize % side;
            for (i, (right, above)) in
                [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].into_iter().enumerate()
            {
                let weight = |at: f32, beyond: f32| (1.0 - beyond - at.fract()).abs();
                taps[4 * level + i] =
                    (texel(x + right, y + above), share * weight(x, right) * weight(y, above));
            }
        }
        taps
    }

    fn initial(&self, materials: usize) -> Vec<f32> {
        let mut seed = 0.3f32;
        let mut number = |scale: f32| {
            seed = (seed * 97.3 + 0.17).fract();
            scale * (2.0 * seed - 1.0)
        };
        let network = (0..self.shape.len()).map(|_| number(0.4)).collect::<Vec<f32>>();
        let own = (0..materials * self.own_len()).map(|_| number(1.0));
        network.into_iter().chain(own).collect()
    }
}

struct Room {
    network: Workspace,
    model: [Row; 3],
    slopes: [Row; 3],
}

/// Every place of a block.
fn places() -> impl Iterator<Item = (usize, usize)> {
    (0..COLUMNS).flat_map(|column| (0..LANES).map(move |lane| (column, lane)))
}

impl Objective for Texture {
    type Workspace = Box<Room>;

    fn shared_len(&self) -> usize {
        self.shape.len()
    }

    fn own_len(&self) -> usize {
        CODE + self.table().len()
    }

    fn table(&self) -> Table {
        Table { rows: self.side * self.side + (self.side / 2).pow(2), width: WIDTH }
    }

    fn workspace(&self) -> Box<Room> {
        let network = Workspace::new(&self.shape);
        Box::new(Room { network, model: [ZERO_ROW; 3], slopes: [ZERO_ROW; 3] })
    }

    fn block(
        &self,
        room: &mut Box<Room>,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        gradient: &mut Gradient,
    ) -> f64 {
        let Room { network, model, slopes } = &mut **room;
        let (code, texels) = own.split_at(CODE);
        let taps = |(column, lane): (usize, usize)| {
            let [light, view] =
                [&pairs.light, &pairs.view].map(|v| v.each_ref().map(|row| row[column][lane]));
            self.taps(light, view)
        };
        let inputs = &mut network.values[0];
        for (input, &x) in inputs[WIDTH..].iter_mut().zip(code) {
            *input = [[x; LANES]; COLUMNS];
        }
        for (column, lane) in places() {
            for (i, input) in inputs[..WIDTH].iter_mut().enumerate() {
                input[column][lane] =
                    taps((column, lane)).iter().map(|&(row, weight)| weight * texels[row * WIDTH + i]).sum();
            }
        }
        forward(&self.shape, shared, network);
        let rows = |rows: &[Row]| -> Vec<f32> { rows.as_flattened().as_flattened().to_vec() };
        let y = rows(network.outputs());
        model.as_flattened_mut().as_flattened_mut().iter_mut().zip(y).for_each(|(f, y)| *f = y.exp());
        let mut total = [0.0; LANES];
        loss_rows(self.loss, pairs, target, model, slopes, &mut total);
        let by_y = rows(&slopes[..]).into_iter().zip(rows(&model[..])).map(|(slope, f)| slope * f);
        let delta = network.output_delta().as_flattened_mut().as_flattened_mut();
        delta.iter_mut().zip(by_y).for_each(|(delta, by_y)| *delta = by_y);
        backward(&self.shape, shared, network, &mut gradient.shared);

        let delta = network.input_delta();
        for (sum, delta) in gradient.own.iter_mut().zip(&delta[WIDTH..]) {
            *sum += sum_row(delta);
        }
        for (column, lane) in places() {
            for (row, weight) in taps((column, lane)) {
                let row = gradient.rows.row(row);
                row.iter_mut().zip(delta).for_each(|(sum, delta)| *sum += weight * delta[column][lane]);
            }
        }
        total.iter().map(|&x| f64::from(x)).sum()
    }
}

/// The same with dense derivatives.
struct Dense(Texture);

impl Objective for Dense {
    type Workspace = Box<Room>;

    fn shared_len(&self) -> usize {
        self.0.shared_len()
    }

    fn own_len(&self) -> usize {
        self.0.own_len()
    }

    fn workspace(&self) -> Box<Room> {
        self.0.workspace()
    }

    fn block(
        &self,
        room: &mut Box<Room>,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        gradient: &mut Gradient,
    ) -> f64 {
        let mut sparse = self.0.zero_gradient();
        let loss = self.0.block(room, shared, own, pairs, target, &mut sparse);
        let all = |sum: &mut [f32], part: &[f32]| sum.iter_mut().zip(part).for_each(|(sum, x)| *sum += x);
        all(&mut gradient.shared, &sparse.shared);
        all(&mut gradient.own[..CODE], &sparse.own);
        for (row, part) in sparse.rows.iter() {
            all(&mut gradient.own[CODE + row * WIDTH..][..WIDTH], part);
        }
        loss
    }
}

/// Stripes.
struct Stripes(f32);

impl Brdf for Stripes {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        Vec3::new(0.5, 0.3, 0.1) * (1.1 + (self.0 * light.x).sin())
            + Vec3::splat(0.2 * (3.0 * view.y).cos().powi(2))
    }
}

const STRIPES: [Stripes; 2] = [Stripes(5.0), Stripes(9.0)];

fn schedule(steps: u64) -> Schedule {
    // A step is always clipped, so that the norm counts.
    Schedule { clip: 1e-3, ..Schedule::standard(steps, 3) }
}

fn trained<O: Objective>(objective: &O, state: &mut State, schedule: &Schedule, stop: u64) -> End {
    let truths = STRIPES.each_ref().map(|stripes| Truth::Brdf(stripes));
    train(objective, &truths, schedule, state, &mut |progress, _| {
        if progress.step == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
}

#[test]
fn sparse_derivatives_are_finite_differences() {
    let texture = Texture::new(8, Loss { absolute: 0.0, squared: 1.0, relative: 0.0 });
    let mut numbers = texture.initial(1);
    let pairs = &draw(Drawing::Lobes, 3, 1, 1)[0];
    let target = &evaluate(&STRIPES[0], std::slice::from_ref(pairs))[0];
    let mut room = texture.workspace();
    let mut evaluate = |numbers: &[f32]| {
        let (shared, own) = numbers.split_at(texture.shared_len());
        let mut gradient = texture.zero_gradient();
        (texture.block(&mut room, shared, own, pairs, target, &mut gradient), gradient)
    };
    let (loss, Gradient { shared, own, rows }) = evaluate(&numbers);
    let mut dense = [shared, own, vec![0.0; texture.table().len()]].concat();
    let first = texture.shared_len() + CODE;
    for (row, values) in rows.iter() {
        dense[first + row * WIDTH..][..WIDTH].copy_from_slice(values);
    }
    let touched = rows.iter().count();
    assert!(touched > texture.table().rows / 2 && touched < texture.table().rows, "{touched}");
    for (kind, range, step) in [
        ("network", 0..texture.shared_len(), 5),
        ("code", texture.shared_len()..first, 1),
        ("texel", first..numbers.len(), 1),
    ] {
        let largest = dense[range.clone()].iter().fold(0.0f32, |a, g| a.max(g.abs()));
        assert!(largest > 1e-3, "{kind} has no derivative");
        for n in range.step_by(step) {
            const STEP: f32 = 4e-3;
            let original = numbers[n];
            let mut at = |x: f32| {
                numbers[n] = x;
                evaluate(&numbers).0
            };
            let (above, below) = (at(original + STEP), at(original - STEP));
            numbers[n] = original;
            if n >= first && rows.iter().all(|(row, _)| row != (n - first) / WIDTH) {
                assert_eq!((above, below), (loss, loss), "{kind} {n} is not touched");
            }
            let slope = (above - below) / f64::from(2.0 * STEP);
            let error = (f64::from(dense[n]) - slope).abs();
            let tolerance = 0.01 * slope.abs() + 2e-3 * f64::from(largest);
            assert!(error < tolerance, "{kind} {n}: {} against {slope}", dense[n]);
        }
    }
}

#[test]
fn sparse_is_dense_to_the_bit_where_every_row_is_touched() {
    const STEPS: u64 = 60;
    let texture = Texture::new(4, DEFAULT_LOSS);
    let numbers = texture.initial(2);
    let mut sparse = State::of(&texture, 2, numbers.clone());
    let mut dense = State::new(numbers);
    for end in [
        trained(&texture, &mut sparse, &schedule(STEPS), u64::MAX),
        trained(&Dense(texture), &mut dense, &schedule(STEPS), u64::MAX),
    ] {
        assert_eq!(end, End::Finished);
    }
    assert!(sparse.moments.touched.iter().all(|&touched| u64::from(touched) == STEPS));
    assert_eq!(sparse.numbers, dense.numbers);
    assert_eq!(sparse.moments.first, dense.moments.first);
    assert_eq!(sparse.moments.second, dense.moments.second);
}

#[test]
fn rows_that_no_step_touches_stay_and_the_others_have_a_time_of_their_own() {
    let texture = Texture::new(512, DEFAULT_LOSS);
    let first = texture.initial(2);
    let mut state = State::of(&texture, 2, first.clone());
    // So long that the rate is all but constant until the fit is stopped.
    let schedule = schedule(1_000_000);
    assert_eq!(trained(&texture, &mut state, &schedule, 50), End::Stopped);
    let (own_len, Table { rows, width }) = (texture.own_len(), texture.table());
    let (mut untouched, mut touched_once) = (0, 0);
    for (i, &touched) in state.moments.touched.iter().enumerate() {
        let start = texture.shared_len() + i / rows * own_len + CODE + i % rows * width;
        for n in start..start + width {
            let moved = (state.numbers[n] - first[n]).abs();
            let mean = state.moments.first[n];
            if touched == 0 {
                assert_eq!([moved, mean, state.moments.second[n]], [0.0; 3]);
                untouched += 1;
            }
            // The first step of a number has the length of the rate, however late it is; that of a derivative which
            // is as small as the optimiser's epsilon is shorter.
            if touched == 1 && mean.abs() > 1e-7 {
                assert!((moved / schedule.rate - 1.0).abs() < 0.02, "{moved}");
                touched_once += 1;
            }
        }
    }
    assert!(untouched > 1000 && touched_once > 1000, "{untouched} {touched_once}");
}

#[test]
fn sparse_fits_do_not_depend_on_threads_or_interruptions() {
    let texture = Texture::new(128, DEFAULT_LOSS);
    let schedule = schedule(100);
    let start = || State::of(&texture, 2, texture.initial(2));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut state = start();
        pool.install(|| trained(&texture, &mut state, &schedule, u64::MAX));
        state
    };
    let one = on(1);
    assert_eq!(one, on(3));

    let mut state = start();
    assert_eq!(trained(&texture, &mut state, &schedule, 50), End::Stopped);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint");
    // The file does not look into the model.
    let options = Options { model: Model::Ggx(GgxOptions { loss: DEFAULT_LOSS }), schedule };
    Checkpoint { options, materials: Vec::new(), state }.save(&path).unwrap();
    let mut state = Checkpoint::open(&path).unwrap().state;
    assert_eq!(trained(&texture, &mut state, &schedule, u64::MAX), End::Finished);
    assert_eq!(one, state);
}
