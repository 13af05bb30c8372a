//! Surfaces from inside a kernel that Dr.Jit compiled, by the way of [`crate::ray_hit`]: each lane has a place.
//!
//! | field of the ray | value |
//! |---|---|
//! | origin | light; for a sample three random numbers |
//! | direction | view |
//! | time, far end | uv |
//! | near end, mask | the footprint, see [`footprint`] |
//!
//! f comes back in the hit's u, v and primitive, and the density of the light in the geometry. Of a sample the weight
//! and the density, 0 for a failed one, come back there, and the light in the far end and the instance: x/(1 + z) and
//! y/(1 + z), of which z is made without losing its digits at the horizon.

use std::cell::RefCell;
use std::ffi::c_void;

use glimt_core::material::At;
use glimt_core::models::Local;
use glimt_core::simd::LANES;
use glimt_core::surface::{Footprint, Place};
use glimt_core::{Brdf, Sample, SampleBrdf, Vec3};

use crate::material::{Material, guarded};
use crate::ray_hit::{RayHit, address_of_width};

/// Address of the function that answers f and densities, for packets of `width` lanes; 0 where no such width is
/// served.
pub fn eval_at_packet_address(width: usize) -> usize {
    address_of_width(width, eval_at_packet::<4>, eval_at_packet::<8>, eval_at_packet::<16>)
}

/// The same of the function that samples.
pub fn sample_at_packet_address(width: usize) -> usize {
    address_of_width(width, sample_at_packet::<4>, sample_at_packet::<8>, sample_at_packet::<16>)
}

/// f and the density of every active lane.
///
/// # Safety
///
/// `valid` points to N numbers, `packet` to a packet that nobody else touches during the call, and
/// the addresses in its active lanes to live materials.
unsafe extern "C" fn eval_at_packet<const N: usize>(
    valid: *const i32,
    _scene: *const c_void,
    _context: *const c_void,
    packet: *mut RayHit<N>,
) {
    // SAFETY: the caller's promise.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    let mut pairs = Pairs::<N>::none();
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        let (light, view) = (packet.origin_of(lane), packet.direction_of(lane));
        let ask = |at: &At<'_>| (eval_at_hand(at, light, view), at.pdf(light, view));
        // SAFETY: the lane is active.
        let (f, pdf) = guarded((Some(Vec3::ZERO), 0.0), || unsafe { seen(packet, lane, ask) });
        packet.answer(lane, f.unwrap_or(Vec3::ZERO), pdf);
        if f.is_none() {
            pairs.push(packet, lane, light);
        }
    }
    // SAFETY: its lanes are active.
    guarded((), || unsafe { pairs.eval(packet) });
}

/// A sample for every active lane. Arguments and safety as for [`eval_at_packet`].
unsafe extern "C" fn sample_at_packet<const N: usize>(
    valid: *const i32,
    _scene: *const c_void,
    _context: *const c_void,
    packet: *mut RayHit<N>,
) {
    // SAFETY: the caller's promise.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    let mut pairs = Pairs::<N>::none();
    let mut lights = [Sample::FAILED.light; N];
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        let (u, view) = (packet.origin_of(lane), packet.direction_of(lane));
        let ask = |at: &At<'_>| {
            let (light, pdf) = at.sample_direction(view, u)?;
            Some((light, pdf, eval_at_hand(at, light, view)))
        };
        // SAFETY: the lane is active.
        let drawn = guarded(None, || unsafe { seen(packet, lane, ask) });
        let (light, pdf, f) = drawn.unwrap_or((lights[lane], 0.0, Some(Vec3::ZERO)));
        lights[lane] = light;
        packet.answer(lane, f.unwrap_or(Vec3::ZERO), pdf);
        if f.is_none() {
            pairs.push(packet, lane, light);
        }
    }
    // SAFETY: its lanes are active.
    guarded((), || unsafe { pairs.eval(packet) });
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        let (Vec3 { x, y, z }, pdf) = (lights[lane], packet.geometry[lane]);
        let weight = Vec3::from_array(packet.hit.map(|f| f[lane])) * (z / pdf);
        let is_sound = pdf > 0.0 && weight.is_finite();
        let (weight, pdf) = if is_sound { (weight, pdf) } else { (Vec3::ZERO, 0.0) };
        packet.answer(lane, weight, pdf);
        (packet.far[lane], packet.instance[lane]) = (x / (1.0 + z), y / (1.0 + z));
    }
}

/// f of a facet, which takes less than to look for its texels. Networks are evaluated for many lanes in one pass, though
/// their texels are looked for once more.
fn eval_at_hand(at: &At<'_>, light: Vec3, view: Vec3) -> Option<Vec3> {
    matches!(at, At::Place(Local::Facet(_))).then(|| at.eval(light, view))
}

/// Pairs of directions of a packet, one a lane, whose f is still to be found.
struct Pairs<const N: usize> {
    lanes: [usize; N],
    len: usize,
    places: [Place; N],
    light: [[f32; N]; 3],
    view: [[f32; N]; 3],
}

impl<const N: usize> Pairs<N> {
    fn none() -> Self {
        let zeros = [[0.0; N]; 3];
        Pairs { lanes: [0; N], len: 0, places: [Place::far(); N], light: zeros, view: zeros }
    }

    fn push(&mut self, packet: &RayHit<N>, lane: usize, light: Vec3) {
        self.lanes[self.len] = lane;
        self.places[self.len] = place_of(packet, lane);
        for c in 0..3 {
            self.light[c][self.len] = light[c];
            self.view[c][self.len] = packet.direction[c][lane];
        }
        self.len += 1;
    }

    /// Answers f of every pair in u, v and the primitive of its lane: neighbours of one material at a time.
    ///
    /// # Safety
    ///
    /// The lanes are active, so that they hold the addresses of live materials.
    unsafe fn eval(&self, packet: &mut RayHit<N>) {
        let mut first = 0;
        while first < self.len {
            // SAFETY: the caller's promise.
            let material_of = |pair: usize| unsafe { packet.material(self.lanes[pair]) };
            let material = material_of(first);
            let same = (first..self.len).take_while(|&pair| std::ptr::eq(material_of(pair), material));
            let run = first..first + same.count();
            let mut f = [[0.0; N]; 3];
            material.material.eval_packet_at(
                &self.places[run.clone()],
                self.light.each_ref().map(|component| &component[run.clone()]),
                self.view.each_ref().map(|component| &component[run.clone()]),
                f.each_mut().map(|channel| &mut channel[run.clone()]),
            );
            for pair in run.clone() {
                for c in 0..3 {
                    packet.hit[c][self.lanes[pair]] = f[c][pair];
                }
            }
            first = run.end;
        }
    }
}

/// What a lane saw, and where.
#[derive(Clone, Copy)]
struct Seen {
    /// The number of the material.
    material: u64,
    /// The bits of uv and of the footprint.
    place: [u32; 4],
    at: At<'static>,
}

thread_local! {
    /// What each lane saw last: a path tracer asks for f towards a light and then for a sample at the same place.
    static LAST: RefCell<[Option<Seen>; LANES]> = const { RefCell::new([None; LANES]) };
}

/// What `ask` finds where a lane asks.
///
/// # Safety
///
/// The lane is active, so that it holds the address of a live material.
unsafe fn seen<const N: usize, T>(packet: &RayHit<N>, lane: usize, ask: impl FnOnce(&At<'_>) -> T) -> T {
    const { assert!(N <= LANES) };
    // SAFETY: the caller's promise.
    let Material { material, number, .. } = unsafe { packet.material(lane) };
    let uv = [packet.time[lane], packet.far[lane]].map(f32::to_bits);
    let place = [uv[0], uv[1], packet.near[lane].to_bits(), packet.mask[lane]];
    LAST.with_borrow_mut(|last| match &last[lane] {
        Some(seen) if seen.material == *number && seen.place == place => ask(&seen.at),
        _ => {
            let at = material.at(&place_of(packet, lane));
            // SAFETY: it is looked at again only with a live material of the same number, which is this one.
            let kept = unsafe { std::mem::transmute::<At<'_>, At<'static>>(at) };
            last[lane] = Some(Seen { material: *number, place, at: kept });
            ask(&at)
        }
    })
}

/// Where a lane asks.
fn place_of<const N: usize>(packet: &RayHit<N>, lane: usize) -> Place {
    Place {
        uv: [packet.time[lane], packet.far[lane]],
        footprint: footprint(packet.near[lane].to_bits(), packet.mask[lane]),
    }
}

/// The footprint whose axes are the columns of a lower triangular matrix: three numbers in 64 bits, of 21, 22 and 21.
/// Each is a float without the last ten bits of its mantissa, and the two on the diagonal have no sign either.
fn footprint(first: u32, second: u32) -> Footprint {
    let long = |short: u32| f32::from_bits(short << 10);
    let (u, v) = (first >> 11, second & ((1 << 21) - 1));
    let shear = (first & ((1 << 11) - 1)) << 11 | second >> 21;
    Footprint::Axes([[long(u), long(shear)], [0.0, long(v)]])
}

#[cfg(test)]
mod tests {
    use glimt_check::extremes;
    use glimt_core::library::{Entry, Origin};
    use glimt_core::models::maps::{Filter, Maps, Texel};
    use glimt_core::surface::Wrap;
    use glimt_core::{Kind, Library, Material as AnyMaterial};

    use super::*;
    use crate::material::open;

    /// A number in [0, 1) of index `i`, another sequence for every `k`.
    fn number(i: usize, k: usize) -> f32 {
        ((i + 1) as f32 * (0.618_034 + 0.137 * k as f32)).fract()
    }

    fn direction(i: usize, k: usize) -> Vec3 {
        let (z, phi) = (number(i, k), number(i, k + 1) * std::f32::consts::TAU);
        let r = (1.0 - z * z).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    }

    fn maps() -> AnyMaterial {
        let texel = |i: usize| Texel {
            kd: [0, 1, 2].map(|k| number(i, k)),
            f0: [0.04; 3],
            alpha: 0.1 + 0.5 * number(i, 3),
            slope: [number(i, 4) - 0.5, number(i, 5) - 0.5],
        };
        Maps::new(5, (0..35).map(texel), Wrap::Repeat, Filter::Moments).unwrap().into()
    }

    /// Two surfaces and a material that is the same everywhere, of one file each.
    fn materials() -> [Box<Material>; 3] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("maps.safetensors");
        let entries = ["a", "b"].map(|name| Entry {
            name: name.to_owned(),
            material: maps(),
            origin: Origin::default(),
        });
        Library::new(&path, entries.into()).unwrap().save().unwrap();
        let homogeneous = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/models/rgl.safetensors");
        [(path.to_str().unwrap(), "a"), (path.to_str().unwrap(), "b"), (homogeneous, "chm_orange")]
            .map(|(path, name)| open(path, name, "").unwrap())
    }

    /// The 64 bits of a lower triangular matrix, as the plugin makes them.
    fn shortened(u: f32, shear: f32, v: f32) -> (u32, u32) {
        let [u, shear, v] = [u, shear, v].map(|x| (x.to_bits() + 512) >> 10);
        (u << 11 | shear >> 11, shear << 21 | v)
    }

    #[test]
    fn a_footprint_keeps_thirteen_bits_of_every_number() {
        for i in 0..1000 {
            let [u, shear, v] = [0, 1, 2].map(|k| 10f32.powf(12.0 * number(i, k) - 8.0));
            let shear = if i % 2 == 0 { shear } else { -shear };
            let (first, second) = shortened(u, shear, v);
            let Footprint::Axes([[a, b], [zero, c]]) = footprint(first, second) else { panic!() };
            for (kept, given) in [(a, u), (b, shear), (c, v)] {
                assert!((kept - given).abs() <= given.abs() / 16384.0, "{kept} for {given}");
            }
            assert!(zero == 0.0);
        }
        let Footprint::Axes(nothing) = footprint(0, 0) else { panic!() };
        assert_eq!(nothing, [[0.0; 2]; 2]);
    }

    /// A packet whose lanes ask different materials at different places, and some none.
    fn check<const N: usize>(materials: &[Box<Material>]) {
        let mut packet = RayHit::<N>::of(&materials[0]);
        let valid: [i32; N] = std::array::from_fn(|lane| if lane % 5 == 3 { 0 } else { -1 });
        for lane in 0..N {
            for (c, component) in direction(lane, 0).to_array().into_iter().enumerate() {
                packet.origin[c][lane] = component;
            }
            for (c, component) in direction(lane, 2).to_array().into_iter().enumerate() {
                packet.direction[c][lane] = component;
            }
            (packet.time[lane], packet.far[lane]) =
                (3.0 * number(lane, 4) - 1.0, 3.0 * number(lane, 5) - 1.0);
            let (first, second) =
                shortened(0.5 * number(lane, 6), number(lane, 7) - 0.5, 0.5 * number(lane, 8));
            (packet.near[lane], packet.mask[lane]) = (f32::from_bits(first), second);
            let address =
                if valid[lane] == 0 { 0 } else { &raw const *materials[lane % materials.len()] as u64 };
            (packet.id[lane], packet.flags[lane]) = (address as u32, (address >> 32) as u32);
        }
        let places: [Place; N] = std::array::from_fn(|lane| place_of(&packet, lane));
        let lanes: Vec<usize> = (0..N).filter(|&lane| valid[lane] != 0).collect();
        let answers = |packet: &RayHit<N>, lane: usize| {
            (Vec3::from_array([0, 1, 2].map(|c| packet.hit[c][lane])), packet.geometry[lane])
        };
        // SAFETY: arrays of N, and the addresses in the active lanes are those of materials.
        unsafe { eval_at_packet::<N>(valid.as_ptr(), std::ptr::null(), std::ptr::null(), &raw mut packet) };
        for &lane in &lanes {
            let at = materials[lane % materials.len()].material.at(&places[lane]);
            let (light, view) = (direction(lane, 0), direction(lane, 2));
            let (f, pdf) = answers(&packet, lane);
            let expected = at.eval(light, view);
            assert!(
                (f - expected).abs().max_element() <= 1e-5 * expected.max_element(),
                "{f} for {expected}"
            );
            let expected = at.pdf(light, view);
            assert!((pdf - expected).abs() <= 1e-5 * expected, "{pdf} for {expected}");
        }
        // Random numbers are not negative.
        packet.origin = packet.origin.map(|component| component.map(f32::abs));
        // SAFETY: as above.
        unsafe { sample_at_packet::<N>(valid.as_ptr(), std::ptr::null(), std::ptr::null(), &raw mut packet) };
        for &lane in &lanes {
            let at = materials[lane % materials.len()].material.at(&places[lane]);
            let expected = at.sample(direction(lane, 2), direction(lane, 0).abs());
            let (weight, pdf) = answers(&packet, lane);
            let (x, y) = (packet.far[lane], packet.instance[lane]);
            let light = Vec3::new(2.0 * x, 2.0 * y, 1.0 - x * x - y * y) / (1.0 + x * x + y * y);
            assert_eq!(pdf > 0.0, expected.pdf > 0.0);
            if pdf > 0.0 {
                assert!((light - expected.light).abs().max_element() <= 1e-6);
                assert!((pdf - expected.pdf).abs() <= 1e-5 * expected.pdf, "{pdf} for {}", expected.pdf);
                assert!(
                    (weight - expected.weight).abs().max_element() <= 1e-5 * expected.weight.max_element()
                );
            }
        }
    }

    #[test]
    fn surfaces_of_every_model_are_asked_at_their_places() {
        let folder = tempfile::tempdir().unwrap();
        let mut kinds = std::collections::BTreeSet::new();
        for (path, case) in extremes::save_files(folder.path()).unwrap() {
            let material = open(path.to_str().unwrap(), "", case.sampler).unwrap();
            if material.material.is_surface() {
                kinds.insert(material.material.kind());
                check::<8>(&[material]);
            }
        }
        assert!(kinds.contains(&Kind::Maps) && kinds.contains(&Kind::Gated));
    }

    #[test]
    fn every_lane_is_asked_at_its_place() {
        let materials = materials();
        check::<4>(&materials);
        check::<8>(&materials);
        check::<16>(&materials);
    }
}
