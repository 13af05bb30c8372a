//! Evaluation from inside a kernel that Dr.Jit compiled.
//!
//! Dr.Jit can call out of a compiled kernel in one place: where it traces rays, with the calling
//! convention of Embree's N-wide intersection functions (Embree 3, `rtcIntersect4/8/16`). Directions
//! pose as a ray, one view and two lights in each lane: a path tracer asks for f towards the light that
//! it sampled and for f towards the direction that it goes on to, and both in one call fill the tiles.
//!
//! | field of the ray | value |
//! |---|---|
//! | origin | first light |
//! | direction | view |
//! | near end, time, far end | second light |
//! | mask | which of the lights are asked for, see [`FIRST`] and [`SECOND`] |
//! | id, flags | the material's address, per lane and as data: a pointer for the scene would be baked into a frozen function |
//!
//! f of the first pair comes back in the hit's u, v and primitive; f of the second in the far end, the
//! geometry and the instance; what is an integer there holds the bits of a float.

use std::ffi::c_void;

use glimt_core::simd::{LANES, Lane3};

use crate::bridge::{Material, guarded};

/// Bits of [`Packet::wanted`].
const FIRST: u32 = 1;
const SECOND: u32 = 2;

/// Embree's `RTCRayHitN` with our values in its fields.
#[repr(C)]
pub struct Packet<const N: usize> {
    light: [[f32; N]; 3],
    second_x: [f32; N],
    view: [[f32; N]; 3],
    second_y: [f32; N],
    /// The second light's z, and then red of the second f.
    second_z: [f32; N],
    wanted: [u32; N],
    address_low: [u32; N],
    address_high: [u32; N],
    _normal: [[f32; N]; 3],
    /// f of the first pair.
    first: [[f32; N]; 3],
    /// Green and blue of the second f.
    second: [[f32; N]; 2],
}

/// Address of [`eval_packet`] for packets of `width` lanes, or 0 where no such width is served.
pub fn eval_packet_address(width: usize) -> usize {
    type Function<const N: usize> =
        unsafe extern "C" fn(*const i32, *const c_void, *const c_void, *mut Packet<N>);
    match width {
        4 => eval_packet::<4> as Function<4> as usize,
        8 => eval_packet::<8> as Function<8> as usize,
        16 => eval_packet::<16> as Function<16> as usize,
        _ => 0,
    }
}

/// f_r for what the active lanes of a packet want, with the arguments of `rtcIntersectN`: per lane −1
/// (active) or 0, a scene and a context that we have no use for, and the packet.
///
/// Other lanes hold no meaning afterwards.
///
/// # Safety
///
/// `valid` points to N numbers, `packet` to a packet that nobody else touches during the call, and
/// the addresses in its active lanes to live materials.
unsafe extern "C" fn eval_packet<const N: usize>(
    valid: *const i32,
    _scene: *const c_void,
    _context: *const c_void,
    packet: *mut Packet<N>,
) {
    const { assert!(N <= LANES) };
    // SAFETY: the caller's promise, see above.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    let mut first = 0;
    let mut second = 0;
    for lane in 0..N {
        let wanted = if valid[lane] != 0 { packet.wanted[lane] } else { 0 };
        first |= u32::from(wanted & FIRST != 0) << lane;
        second |= u32::from(wanted & SECOND != 0) << lane;
    }
    let mut pending = first | (second << N);
    if pending != 0 {
        let mut pairs = Pairs::new(packet);
        guarded((), || {
            while pending != 0 {
                pending &= !pairs.eval_some(packet, pending);
            }
        });
        pairs.store(packet);
    }
}

impl<const N: usize> Packet<N> {
    /// The material of a lane that is active.
    fn material(&self, lane: usize) -> &glimt_core::Material {
        let address = u64::from(self.address_high[lane]) << 32 | u64::from(self.address_low[lane]);
        // SAFETY: the lane is active, and so this is the address of a live material.
        unsafe { &*(address as usize as *const Material) }.core()
    }
}

/// Twice N pairs in a row, the first of all lanes and then the second.
struct Pairs {
    light: [[f32; 2 * LANES]; 3],
    view: [[f32; 2 * LANES]; 3],
    f: [[f32; 2 * LANES]; 3],
}

impl Pairs {
    fn new<const N: usize>(packet: &Packet<N>) -> Self {
        let mut pairs =
            Pairs { light: [[0.0; 2 * LANES]; 3], view: [[0.0; 2 * LANES]; 3], f: [[0.0; 2 * LANES]; 3] };
        let second = [&packet.second_x, &packet.second_y, &packet.second_z];
        for c in 0..3 {
            pairs.light[c][..N].copy_from_slice(&packet.light[c]);
            pairs.light[c][N..2 * N].copy_from_slice(second[c]);
            pairs.view[c][..N].copy_from_slice(&packet.view[c]);
            pairs.view[c][N..2 * N].copy_from_slice(&packet.view[c]);
        }
        pairs
    }

    /// Evaluates up to a tile of the pairs in the bit set `pending`, of materials that can share one;
    /// returns the set of those that it did.
    fn eval_some<const N: usize>(&mut self, packet: &Packet<N>, pending: u32) -> u32 {
        let tile = Tile::choose(packet, pending);
        // Lanes beyond the pairs are directions of zero, which carry nothing.
        let mut light: Lane3 = [[0.0; LANES]; 3];
        let mut view: Lane3 = [[0.0; LANES]; 3];
        for c in 0..3 {
            for (lane, &pair) in tile.pairs[..tile.len].iter().enumerate() {
                light[c][lane] = self.light[c][pair];
                view[c][lane] = self.view[c][pair];
            }
        }
        let mut f: Lane3 = [[0.0; LANES]; 3];
        tile.eval(&light, &view, &mut f);
        for c in 0..3 {
            for (lane, &pair) in tile.pairs[..tile.len].iter().enumerate() {
                self.f[c][pair] = f[c][lane];
            }
        }
        tile.set
    }

    fn store<const N: usize>(&self, packet: &mut Packet<N>) {
        for c in 0..3 {
            packet.first[c].copy_from_slice(&self.f[c][..N]);
        }
        packet.second_z.copy_from_slice(&self.f[0][N..2 * N]);
        for c in 1..3 {
            packet.second[c - 1].copy_from_slice(&self.f[c][N..2 * N]);
        }
    }
}

/// The pairs that go into a tile, and their materials; pairs of one material are neighbours.
struct Tile<'a> {
    pairs: [usize; LANES],
    materials: [&'a glimt_core::Material; LANES],
    len: usize,
    set: u32,
}

impl<'a> Tile<'a> {
    /// As many of `pending` as can be evaluated with the first of them.
    fn choose<const N: usize>(packet: &'a Packet<N>, mut pending: u32) -> Self {
        let first = packet.material(pending.trailing_zeros() as usize % N);
        let mut tile = Tile { pairs: [0; LANES], materials: [first; LANES], len: 0, set: 0 };
        while pending != 0 && tile.len < LANES {
            let material = packet.material(pending.trailing_zeros() as usize % N);
            let fits = first.shares_tiles_with(material);
            let mut left = pending;
            while left != 0 {
                let pair = left.trailing_zeros() as usize;
                left &= left - 1;
                if std::ptr::eq(packet.material(pair % N), material) {
                    pending &= !(1 << pair);
                    if fits && tile.len < LANES {
                        tile.push(pair, material);
                    }
                }
            }
        }
        tile
    }

    fn push(&mut self, pair: usize, material: &'a glimt_core::Material) {
        self.pairs[self.len] = pair;
        self.materials[self.len] = material;
        self.len += 1;
        self.set |= 1 << pair;
    }

    /// f_r in every lane; those beyond the pairs hold no meaning.
    fn eval(&self, light: &Lane3, view: &Lane3, f: &mut Lane3) {
        let last = self.materials[self.len - 1];
        let mut materials = self.materials;
        // The rest goes with the last, so that it takes no pass of its own.
        materials[self.len..].fill(last);
        glimt_core::Material::eval_mixed_tile(&materials, light, view, f);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glimt_check::{extremes, stability};
    use glimt_core::directions::features::Inputs;
    use glimt_core::kernels::network::{Activation, Layer, Network};
    use glimt_core::library::{Entry, Origin};
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::hybrid::{Form, Hybrid};
    use glimt_core::{Brdf, Library, Vec3};

    use super::*;
    use crate::bridge::open;

    fn direction(i: usize) -> [f32; 3] {
        let (z, phi) = ((i as f32 * 0.754_877_7).fract(), i as f32 * 2.4);
        let r = (1.0 - z * z).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    }

    /// A packet whose lanes have one of two materials and want either, both or none of their lights.
    fn check<const N: usize>(materials: &[Box<Material>; 2]) {
        let (zero, zeros) = ([0.0; N], [[0.0; N]; 3]);
        let mut packet = Packet {
            light: zeros,
            second_x: zero,
            view: zeros,
            second_y: zero,
            second_z: zero,
            wanted: [0; N],
            address_low: [0; N],
            address_high: [0; N],
            _normal: zeros,
            first: zeros,
            second: [zero; 2],
        };
        let valid: [i32; N] = std::array::from_fn(|lane| if lane % 5 == 3 { 0 } else { -1 });
        for lane in 0..N {
            let [l, m, v] = [direction(lane), direction(lane + 40), direction(lane + 80)];
            for c in 0..3 {
                packet.light[c][lane] = l[c];
                packet.view[c][lane] = v[c];
            }
            (packet.second_x[lane], packet.second_y[lane], packet.second_z[lane]) = (m[0], m[1], m[2]);
            packet.wanted[lane] = lane as u32 % 4;
            let address = if valid[lane] == 0 { 0 } else { &raw const *materials[lane % 3 % 2] as u64 };
            (packet.address_low[lane], packet.address_high[lane]) = (address as u32, (address >> 32) as u32);
        }
        let asked = packet.wanted;
        // SAFETY: arrays of N, and the addresses in the active lanes are those of materials.
        unsafe { eval_packet::<N>(valid.as_ptr(), std::ptr::null(), std::ptr::null(), &raw mut packet) };
        for lane in (0..N).filter(|&lane| valid[lane] != 0) {
            let material = materials[lane % 3 % 2].core();
            let view = Vec3::from_array(direction(lane + 80));
            let first = [0, 1, 2].map(|c| packet.first[c][lane]);
            let second = [packet.second_z[lane], packet.second[0][lane], packet.second[1][lane]];
            for (bit, light, f) in [(FIRST, lane, first), (SECOND, lane + 40, second)] {
                if asked[lane] & bit != 0 {
                    let expected = material.eval(Vec3::from_array(direction(light)), view);
                    let error = (Vec3::from_array(f) - expected).abs().max_element();
                    assert!(error <= 1e-5 * expected.max_element(), "{f:?} against {expected}");
                }
            }
        }
    }

    #[test]
    fn every_lane_gets_what_it_asked_for() {
        let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
        let layer = |inputs: usize, outputs: usize| Layer {
            weight: (0..inputs * outputs).map(|i| 0.3 * (i as f32 * 1.7).sin()).collect(),
            bias: vec![0.05; outputs],
        };
        let layers = vec![layer(form.features() + 4, 16), layer(16, 6)];
        let network = Arc::new(Network::new(layers, form.features(), Activation::HardGelu).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two.safetensors");
        let entries = [0.1, 0.4].map(|alpha| {
            let microfacet = Microfacet { kd: [alpha; 3], eta: [1.5; 3], alpha: [alpha; 2] };
            let hybrid = Hybrid::new(form, network.clone(), microfacet, vec![alpha; 4], 1.0).unwrap();
            Entry { name: alpha.to_string(), material: hybrid.into(), origin: Origin::default() }
        });
        Library::new(&path, entries.into()).unwrap().save().unwrap();
        let materials = ["0.1", "0.4"].map(|name| open(path.to_str().unwrap(), name, "").unwrap());
        check::<4>(&materials);
        check::<8>(&materials);
        check::<16>(&materials);
    }

    /// The pairs `light`, `view` of one material in a packet, as first and as second.
    fn ask<const N: usize>(material: &Material, pairs: &[(Vec3, Vec3)]) -> [[[f32; N]; 3]; 2] {
        let component =
            |of: fn(&(Vec3, Vec3)) -> Vec3, c: usize| std::array::from_fn(|lane| of(&pairs[lane])[c]);
        let [light, view] = [(|pair| pair.0) as fn(&(Vec3, Vec3)) -> Vec3, |pair| pair.1]
            .map(|of| [0, 1, 2].map(|c| component(of, c)));
        let address = &raw const *material as u64;
        let mut packet = Packet::<N> {
            light,
            second_x: light[0],
            view,
            second_y: light[1],
            second_z: light[2],
            wanted: [FIRST | SECOND; N],
            address_low: [address as u32; N],
            address_high: [(address >> 32) as u32; N],
            _normal: [[0.0; N]; 3],
            first: [[f32::NAN; N]; 3],
            second: [[f32::NAN; N]; 2],
        };
        let valid = [-1; N];
        // SAFETY: arrays of N, and the address is that of a material.
        unsafe { eval_packet::<N>(valid.as_ptr(), std::ptr::null(), std::ptr::null(), &raw mut packet) };
        [packet.first, [packet.second_z, packet.second[0], packet.second[1]]]
    }

    #[test]
    fn extreme_inputs_have_the_answers_of_a_batch() {
        fn check<const N: usize>(material: &Material, pairs: &[(Vec3, Vec3)], case: &str) {
            for chunk in pairs.chunks_exact(N) {
                let answers = ask::<N>(material, chunk);
                let batch = stability::eval_batch(material.core(), chunk);
                for (lane, &(light, view)) in chunk.iter().enumerate() {
                    let expected = batch[lane].to_array();
                    for f in answers {
                        let f = f.map(|channel| channel[lane]);
                        assert_eq!(f, expected, "{case}, a packet of {N} at light {light}, view {view}");
                    }
                }
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let pairs: Vec<(Vec3, Vec3)> = extremes::families().into_iter().flat_map(|f| f.pairs).collect();
        for (path, case) in extremes::save_files(folder.path()).unwrap() {
            let material = open(path.to_str().unwrap(), "", case.sampler).unwrap();
            check::<4>(&material, &pairs, &case.name);
            check::<8>(&material, &pairs, &case.name);
            check::<16>(&material, &pairs, &case.name);
        }
    }
}
