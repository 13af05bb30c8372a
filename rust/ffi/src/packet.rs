//! Evaluation from inside a kernel that Dr.Jit compiled.
//!
//! Dr.Jit can call out of a compiled kernel in one place: where it traces rays, with the calling
//! convention of Embree's N-wide intersection functions (Embree 3, `rtcIntersect4/8/16`). A pair of
//! directions poses as a ray: the origin carries the light direction and the ray's direction the
//! view direction. The fields `id` and `flags` carry the material's address, per lane and as data,
//! because a pointer for the scene would be baked into a frozen function. The answer, linear RGB,
//! comes back in the fields `u`, `v` and `primID`, the last as the bits of a float.

use std::ffi::c_void;

use glimt_core::simd::{LANES, Lane3};

use crate::bridge::{Material, guarded};

/// Embree's `RTCRayHitN` with our values in its fields.
#[repr(C)]
pub struct Packet<const N: usize> {
    light: [[f32; N]; 3],
    _near: [f32; N],
    view: [[f32; N]; 3],
    _time: [f32; N],
    _far: [f32; N],
    _mask: [u32; N],
    address_low: [u32; N],
    address_high: [u32; N],
    _normal: [[f32; N]; 3],
    red: [f32; N],
    green: [f32; N],
    blue: [f32; N],
    _geometry_and_instance: [[u32; N]; 2],
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

/// f_r for the active lanes of a packet, with the arguments of `rtcIntersectN`: per lane −1 (active)
/// or 0, a scene and a context that we have no use for, and the packet.
///
/// Inactive lanes keep what they hold.
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
    let light = widen(&packet.light);
    let view = widen(&packet.view);
    let mut pending = valid.map(|v| v != 0);
    // Where several materials share a kernel, so may the lanes of a packet: one round for each.
    while let Some(first) = pending.iter().position(|&p| p) {
        let address = packet.address(first);
        // SAFETY: the lane is active, and so its address is that of a live material.
        let material = unsafe { &*(address as *const Material) };
        let mut value: Lane3 = [[0.0; LANES]; 3];
        guarded((), || material.eval_tile(&light, &view, &mut value));
        for lane in first..N {
            if pending[lane] && packet.address(lane) == address {
                [packet.red[lane], packet.green[lane], packet.blue[lane]] =
                    value.map(|channel| channel[lane]);
                pending[lane] = false;
            }
        }
    }
}

impl<const N: usize> Packet<N> {
    /// Address of a lane's material.
    fn address(&self, lane: usize) -> usize {
        (u64::from(self.address_high[lane]) << 32 | u64::from(self.address_low[lane])) as usize
    }
}

/// The N lanes of a packet as the first of a tile; after them directions of zero, which carry nothing.
fn widen<const N: usize>(direction: &[[f32; N]; 3]) -> Lane3 {
    let mut tile = [[0.0; LANES]; 3];
    for (tile, lanes) in tile.iter_mut().zip(direction) {
        tile[..N].copy_from_slice(lanes);
    }
    tile
}
