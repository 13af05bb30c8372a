use super::*;
use crate::brdf::Brdf;
use crate::directions::healpix::Healpix;
use crate::kernels::ONE_MAX_RELATIVE_DIFFERENCE;
use crate::kernels::network::{Activation, tests::patterned};
use crate::models::spherical::pixelation::Pixelation;
use crate::models::spherical::store::{Codebook, StoreKind};
use crate::models::spherical::tables::{Form, Interpolation, MAX_TABLES, Taps, scalar_taps};
use crate::simd::{LANES, Lane3};
use glam::DVec3;
use half::f16;

const GRIDS: [Grids; 3] = [Grids::Lv, Grids::Hd, Grids::Iso];
const INTERPOLATIONS: [Interpolation; 3] =
    [Interpolation::Bilinear, Interpolation::InverseDistance, Interpolation::Constant];

pub fn form(grids: Grids) -> Form {
    Form {
        grids,
        pixelation: Pixelation::Healpix,
        nside: Healpix::try_from(8).unwrap(),
        nodes: 40,
        features: 8,
        interpolation: Interpolation::Bilinear,
    }
}

/// Smooth features: waves over the place of each row.
fn waves(layout: &Layout) -> Vec<f32> {
    let k = usize::from(layout.form().features);
    let wave = |&(table, place): &(usize, DVec3), j: usize| {
        let phase = (table * k + j) as f64;
        (place.dot(DVec3::new(3.0 + phase, 2.0 - 0.7 * phase, 4.0)) + phase).sin() as f32
    };
    layout.places().iter().flat_map(|place| (0..k).map(move |j| wave(place, j))).collect()
}

/// A network whose outputs are bright in most directions.
fn network(form: Form, activation: Activation) -> Arc<Network> {
    let dark = patterned(&[form.inputs(), 32, 32, 3], form.inputs(), activation);
    let mut layers = dark.layers().to_vec();
    layers[2].bias = vec![3.0, 2.5, 2.0];
    Arc::new(Network::new(layers, form.inputs(), activation).unwrap())
}

pub fn material(form: Form, kind: StoreKind) -> Spherical {
    material_with(form, kind, Activation::HardGelu)
}

pub fn material_with(form: Form, kind: StoreKind, activation: Activation) -> Spherical {
    let layout = Arc::new(Layout::new(form).unwrap());
    let k = usize::from(form.features);
    let store = match kind {
        StoreKind::Codebook(bits) => {
            let primitives: Vec<f16> =
                waves(&layout).into_iter().map(f16::from_f32).cycle().take(k << bits).collect();
            let indices = (0..layout.places().len() as u32).map(|i| ((i * 40_503) >> 4) as u16 % (1 << bits));
            Store::Indexed { bits, indices: indices.collect(), codebook: Arc::new(Codebook { primitives }) }
        }
        kind => {
            let tables: Vec<usize> = layout.places().iter().map(|&(table, _)| table).collect();
            Store::new(kind, &waves(&layout), k, &tables)
        }
    };
    Spherical::new(layout, network(form, activation), Features { store, links: None }, 6.0).unwrap()
}

/// Quasi-random pairs, a few of them at the poles, on the axes and near the horizon.
fn pairs(n: usize) -> Vec<(DVec3, DVec3)> {
    let direction = |u: f64, v: f64| {
        let (z, phi) = (0.01 + 0.99 * u.fract(), v.fract() * std::f64::consts::TAU);
        let r = (1.0 - z * z).sqrt();
        // What float32 can hold, so that both sides see the same pair.
        DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3().as_dvec3()
    };
    let mut pairs: Vec<_> = (0..n)
        .map(|i| i as f64 + 0.5)
        .map(|i| (direction(i * 0.856_674_9, i * 0.733_891_9), direction(i * 0.628_706_7, i * 0.538_596_9)))
        .collect();
    pairs.push((DVec3::Z, DVec3::new(0.6, 0.0, 0.8).as_vec3().as_dvec3()));
    pairs.push((DVec3::new(0.0, -0.8, 0.6).as_vec3().as_dvec3(), DVec3::Z));
    pairs
}

/// With the first layer in the tables and, if it is, without.
fn agrees_with_the_reference(material: &Spherical) {
    kernels_agree_with_the_reference(material);
    if material.products.is_some() {
        kernels_agree_with_the_reference(&Spherical { products: None, ..material.clone() });
    }
}

fn kernels_agree_with_the_reference(material: &Spherical) {
    let pairs = pairs(2003);
    let (light, view): (Vec<Vec3>, Vec<Vec3>) = pairs.iter().map(|(l, v)| (l.as_vec3(), v.as_vec3())).unzip();
    let mut batch = vec![Vec3::ZERO; pairs.len()];
    material.eval_batch(&light, &view, &mut batch);
    let form = material.layout().form();
    for (i, &(l, v)) in pairs.iter().enumerate() {
        let difference = (material.eval(light[i], view[i]) - batch[i]).abs().max_element();
        assert!(difference <= ONE_MAX_RELATIVE_DIFFERENCE * batch[i].max_element() + 1e-6, "{form:?}");
        let truth = reference::eval(material, l, v);
        for (f, truth) in batch[i].to_array().into_iter().zip(truth) {
            let error = (f64::from(f) - truth).abs();
            assert!(error <= 1e-4 * truth + 2e-6, "{form:?} at {l} {v}: {f} against {truth}");
        }
    }
    assert!(batch.iter().any(|f| f.max_element() > 1e-3), "{form:?}: all dark");
}

#[test]
fn every_form_agrees_with_the_reference_and_across_kernels() {
    for grids in GRIDS {
        for interpolation in INTERPOLATIONS {
            for (pixelation, features, nside) in [
                (Pixelation::Healpix, 16, 16),
                (Pixelation::Healpix, 8, 1),
                (Pixelation::LatLong, 4, 8),
                (Pixelation::Fibonacci, 8, 8),
            ] {
                let nside = Healpix::try_from(nside).unwrap();
                let form = Form { interpolation, pixelation, features, nside, ..form(grids) };
                if form.validate().is_ok() {
                    agrees_with_the_reference(&material(form, StoreKind::F32));
                }
            }
        }
    }
}

/// Random directions, with every fourth on a boundary: a point of the grid, an axis, the pole, the horizon, a
/// number that is none.
fn boundary_direction(layout: &Layout, i: usize) -> [f32; 3] {
    let odd = [
        [0.0, 0.0, 1.0],
        [-0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [1.0, -0.0, 1e-30],
        [-1.0, 0.0, 0.0],
        [0.6, -0.0, 0.8],
        [0.0, -0.8, 0.6],
        [-0.0, 0.8, 0.6],
        [f32::NAN, 0.6, 0.8],
        [0.6, 0.0, f32::NAN],
        [f32::INFINITY, 0.0, 0.0],
        [f32::MAX, f32::MIN, -1.0],
        [0.3, 0.4, -0.866],
        [0.0; 3],
    ];
    let points = layout.hemisphere().points();
    match i % 8 {
        1 => odd[i / 8 % odd.len()],
        5 => layout.hemisphere().direction(i / 8 % points).as_vec3().to_array(),
        _ => {
            let (z, phi) = (i as f64 * 0.754_877_666_2 % 1.0, i as f64 * 0.569_840_290_9 % 1.0);
            let (r, phi) = ((1.0 - z * z).sqrt(), phi * std::f64::consts::TAU);
            DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3().to_array()
        }
    }
}

crate::dispatch! {
    fn taps_of_tile(isa, layout: &Layout, light: &Lane3, view: &Lane3, taps: &mut [Taps<LANES>; MAX_TABLES]) {
        layout.taps(isa, Vector::load3(isa, light), Vector::load3(isa, view), taps);
    }
}

fn same_taps_as_one_by_one(layout: &Layout, pairs: usize) {
    let grids = layout.form().grids;
    let points = layout.rows().len() as u32;
    for start in (0..pairs).step_by(LANES) {
        let mut sides = [[[0.0; LANES]; 3]; 2];
        let mut scalar = Vec::new();
        for lane in 0..LANES {
            let i = start + lane;
            let [light, view] = [i, 7 * i + 3].map(|i| boundary_direction(layout, i));
            for c in 0..3 {
                sides[0][c][lane] = light[c];
                sides[1][c][lane] = view[c];
            }
            scalar.push(scalar_taps(layout, light, view));
        }
        let mut taps = [Taps::EMPTY; MAX_TABLES];
        taps_of_tile(layout, &sides[0], &sides[1], &mut taps);
        for (lane, scalar) in scalar.into_iter().enumerate() {
            assert_eq!(scalar.len(), grids.tables());
            for (table, scalar) in scalar.into_iter().enumerate() {
                assert_eq!(scalar.len(), layout.tap_count(table));
                for (tap, (point, weight)) in scalar.into_iter().enumerate() {
                    let (found, by) = (taps[table].points[tap][lane], taps[table].weights[tap][lane]);
                    assert!(found < points, "{grids:?}: point {found} of {points}");
                    assert_eq!(found, point as u32, "{:?}, pair {}", layout.form(), start + lane);
                    let same = by.to_bits() == weight.to_bits() || by.is_nan() && weight.is_nan();
                    assert!(same, "{:?}, pair {}: {by} {weight}", layout.form(), start + lane);
                }
            }
        }
    }
}

/// Pixels and weights have the same bits in lanes as one by one, where they are held against a HEALPix library
/// and float64.
#[test]
fn look_ups_in_lanes_are_those_of_single_numbers() {
    let mut forms = 0;
    for grids in GRIDS {
        for interpolation in INTERPOLATIONS {
            for (pixelation, nside, pairs) in [
                (Pixelation::Healpix, 1, 1 << 12),
                (Pixelation::Healpix, 32, 1 << 16),
                (Pixelation::Healpix, 256, 1 << 12),
                (Pixelation::LatLong, 16, 1 << 16),
                (Pixelation::Fibonacci, 4, 1 << 12),
            ] {
                let nside = Healpix::try_from(nside).unwrap();
                let form = Form { interpolation, pixelation, nside, ..form(grids) };
                if let Ok(layout) = Layout::new(form) {
                    same_taps_as_one_by_one(&layout, pairs);
                    forms += pairs;
                }
            }
        }
    }
    assert!(forms > 1_000_000, "{forms} pairs");
}

#[test]
fn every_kind_of_store_is_evaluated_as_it_is_decoded() {
    for kind in [StoreKind::F16, StoreKind::I8, StoreKind::I4, StoreKind::Codebook(5)] {
        agrees_with_the_reference(&material(form(Grids::Lv), kind));
        agrees_with_the_reference(&material(form(Grids::Iso), kind));
    }
}

#[test]
fn the_first_layer_is_in_the_tables_of_every_width_that_kernels_have_where_it_is_small() {
    let product = |width: usize, nside: u16| {
        let form = Form { nside: nside.try_into().unwrap(), ..form(Grids::Iso) };
        let network = patterned(&[form.inputs(), width, 32, 3], form.inputs(), Activation::HardGelu);
        let layout = Arc::new(Layout::new(form).unwrap());
        let features = Features { store: Store::F32(waves(&layout)), links: None };
        Spherical::new(layout, Arc::new(network), features, 6.0).unwrap()
    };
    for width in [16, 32, 64] {
        let material = product(width, 8);
        assert!(material.products.is_some());
        agrees_with_the_reference(&material);
    }
    for material in [product(24, 8), product(64, 64)] {
        assert!(material.products.is_none());
        agrees_with_the_reference(&material);
    }
}

#[test]
fn iso_is_isotropic_and_mirror_symmetric() {
    let material = material(form(Grids::Iso), StoreKind::F32);
    assert!(material.is_isotropic());
    for (l, v) in pairs(100) {
        let (l, v) = (l.as_vec3(), v.as_vec3());
        let turn = glam::Quat::from_rotation_z(1.234);
        let mirror = Vec3::new(1.0, -1.0, 1.0);
        for (l2, v2) in [(turn * l, turn * v), (mirror * l, mirror * v)] {
            let (f, other) = (material.eval(l, v), material.eval(l2, v2));
            assert!((f - other).abs().max_element() <= 1e-3 * f.max_element() + 1e-6, "{f} {other}");
        }
    }
}

/// Mirror images share their rows: half of the points, and those on the plane of symmetry.
#[test]
fn folding_halves_the_hemisphere() {
    for nside in [1u16, 2, 8, 16] {
        let layout = Layout::new(Form { nside: nside.try_into().unwrap(), ..form(Grids::Iso) }).unwrap();
        let points = Healpix::try_from(nside).unwrap().points();
        let on_plane = (0..points).filter(|&i| layout.hemisphere().direction(i).y.abs() < 1e-9).count();
        assert_eq!(layout.places().len() - 3 * 40, (points + on_plane) / 2);
        assert!(layout.places().iter().all(|(_, place)| place.y >= 0.0));
    }
}

/// Between two pairs that are close, f does not jump, whatever edge, seam or pole lies between them.
#[test]
fn bilinear_materials_are_continuous() {
    for grids in GRIDS {
        let material = material(form(grids), StoreKind::F32);
        let mut largest = 0.0f32;
        for (i, (l, v)) in pairs(4000).into_iter().enumerate() {
            // Half of them with the half vector near the normal, where frames turn.
            let l = if i % 2 == 0 { (l * 1e-4 + v.with_x(-v.x).with_y(-v.y)).normalize() } else { l };
            let turn = i as f64 * 2.399;
            let step = 1e-5 * DVec3::new(turn.cos(), turn.sin(), 0.5);
            // In Rusinkiewicz's frame the azimuth turns fast about h = n: no table can follow there.
            if grids == Grids::Iso && (l + v).normalize().truncate().length() < 1e-2 {
                continue;
            }
            let near = material.eval((l + step).normalize().as_vec3(), v.as_vec3());
            let here = material.eval(l.as_vec3(), v.as_vec3());
            let jump = (near - here).abs().max_element() / (here.max_element() + 0.01);
            largest = largest.max(jump);
        }
        assert!(largest < 0.05, "{grids:?}: {largest}");
    }
}

#[test]
fn f_is_finite_and_not_negative_for_every_input() {
    let odd = [0.0, -0.0, 1.0, -1.0, 0.6, 1.9, 1e-30, f32::MAX, f32::NAN, f32::NEG_INFINITY];
    for grids in GRIDS {
        let material = material(form(grids), StoreKind::I8);
        for x in odd {
            for y in odd {
                for z in odd {
                    for other in [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(1.0, 0.0, 1e-30)] {
                        let w = Vec3::new(x, y, z);
                        for f in [material.eval(w, other), material.eval(other, w), material.eval(w, w)] {
                            assert!(f.is_finite() && f.min_element() >= 0.0, "{w} {other}: {f}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn output_is_bounded_and_starts_at_nothing() {
    assert_eq!(from_output(0.0, 5.0), 0.0);
    assert_eq!(from_output(-3.0, 5.0), 0.0);
    assert_eq!(from_output(1e9, 5.0), from_output(5.0, 5.0));
    assert!((from_output(1.0, 5.0) / 0.003 - 1.718_281_8).abs() < 1e-5);
}

#[test]
fn pruned_rows_take_their_parents_features() {
    let whole = material(form(Grids::Lv), StoreKind::F32);
    let layout = whole.layout().clone();
    let rows = layout.places().len();
    // Every table keeps its first row alone.
    let links: Vec<u32> = layout.places().iter().map(|&(table, _)| table as u32).collect();
    let kept: Vec<f32> = waves(&layout)
        .chunks_exact(8)
        .zip(layout.places())
        .scan(usize::MAX, |last, (row, &(table, _))| {
            let is_first = *last != table;
            *last = table;
            Some(if is_first { row.to_vec() } else { Vec::new() })
        })
        .flatten()
        .collect();
    let new = |links: Vec<u32>| {
        let features = Features { store: Store::F32(kept.clone()), links: Some(links) };
        Spherical::new(layout.clone(), whole.network().clone(), features, 6.0)
    };
    let pruned = new(links.clone()).unwrap();
    let (l, v) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6));
    let (a, b) = (pruned.eval(l, v), pruned.eval(v, l));
    assert!((a - b).abs().max_element() < 1e-6 * a.max_element() + 1e-9, "one row per table is a constant");

    let error = |change: &dyn Fn(&mut Vec<u32>)| {
        let mut links = links.clone();
        change(&mut links);
        new(links).unwrap_err()
    };
    assert!(error(&|links| links[3] = 7).contains("kept row 7, expected less than 2"));
    assert!(error(&|links| links[3] = 1).contains("rows of two tables"));
    assert!(
        error(&|links| links.truncate(rows - 1))
            .contains(&format!("links {} rows, expected {rows}", rows - 1))
    );
    assert!(error(&|links| links.iter_mut().for_each(|l| *l = 0)).contains("two tables"));
}

#[test]
fn parts_that_do_not_fit_together_are_refused() {
    let good = material(form(Grids::Iso), StoreKind::Codebook(4));
    let new = |layout: Form, store: Store, bound: f32| {
        let layout = Arc::new(Layout::new(layout).unwrap());
        Spherical::new(layout, good.network().clone(), Features { store, links: None }, bound).unwrap_err()
    };
    let store = good.features().store.clone();
    let Store::Indexed { bits, mut indices, codebook } = store.clone() else { unreachable!() };
    assert!(new(form(Grids::Lv), store.clone(), 1.0).contains("expected 16 to 3"));
    assert!(new(form(Grids::Iso), store.clone(), f32::NAN).contains("bound"));
    assert!(new(form(Grids::Iso), store, MAX_BOUND + 1.0).contains("expected at most 30"));
    indices[5] = 16;
    let broken = Store::Indexed { bits, indices, codebook };
    assert!(new(form(Grids::Iso), broken, 1.0).contains("an index is 16, but the codebook has 16"));
    assert!(new(form(Grids::Iso), Store::F32(vec![0.0; 80]), 1.0).contains("keeps 10 rows"));
    for (form, reason) in [
        (Form { features: 5, ..form(Grids::Lv) }, "expected 4, 8 or 16"),
        (Form { nodes: 1, ..form(Grids::Iso) }, "expected 2 to 1024"),
        (Form { pixelation: Pixelation::Fibonacci, ..form(Grids::Hd) }, "no pixels to be bilinear in"),
    ] {
        assert!(Layout::new(form).unwrap_err().contains(reason));
    }
    assert!(StoreKind::Codebook(13).validate().unwrap_err().contains("expected 1 to 12"));
}
