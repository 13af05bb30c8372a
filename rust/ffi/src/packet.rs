//! Evaluation from inside a kernel that Dr.Jit compiled.
//!
//! Dr.Jit can call out of a compiled kernel in one place: where it traces rays, with the calling
//! convention of Embree's N-wide intersection functions (Embree 3, `rtcIntersect4/8/16`). A material
//! poses as a scene and a pair of directions as a ray: the origin carries the light direction and
//! the ray's direction the view direction. The answer, linear RGB, comes back in the fields `u`, `v`
//! and `primID`, the last as the bits of a float.

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
    _mask_id_flags: [[u32; N]; 3],
    _normal: [[f32; N]; 3],
    red: [f32; N],
    green: [f32; N],
    blue: [f32; N],
    _geometry_and_instance: [[u32; N]; 2],
}

/// Address of [`eval_packet`] for packets of `width` lanes, or 0 where no such width is served.
pub fn eval_packet_address(width: usize) -> usize {
    type Function<const N: usize> =
        unsafe extern "C" fn(*const i32, *const Material, *const c_void, *mut Packet<N>);
    match width {
        4 => eval_packet::<4> as Function<4> as usize,
        8 => eval_packet::<8> as Function<8> as usize,
        16 => eval_packet::<16> as Function<16> as usize,
        _ => 0,
    }
}

/// f_r for the active lanes of a packet, with the arguments of `rtcIntersectN`: per lane −1 (active)
/// or 0, the "scene", a context that we have no use for, and the packet.
///
/// Inactive lanes keep what they hold: where several materials share one kernel, Dr.Jit calls once
/// for each of them on the same packet.
///
/// # Safety
///
/// `valid` points to N numbers, `material` to a live material and `packet` to a packet that nobody
/// else touches during the call.
unsafe extern "C" fn eval_packet<const N: usize>(
    valid: *const i32,
    material: *const Material,
    _context: *const c_void,
    packet: *mut Packet<N>,
) {
    const { assert!(N <= LANES) };
    // SAFETY: the caller's promise, see above.
    let (valid, material, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &*material, &mut *packet) };
    if valid.iter().all(|&v| v == 0) {
        return;
    }
    let light = widen(&packet.light);
    let view = widen(&packet.view);
    let mut value: Lane3 = [[0.0; LANES]; 3];
    guarded((), || material.eval_tile(&light, &view, &mut value));
    for (channel, value) in [&mut packet.red, &mut packet.green, &mut packet.blue].into_iter().zip(&value) {
        for lane in 0..N {
            if valid[lane] != 0 {
                channel[lane] = value[lane];
            }
        }
    }
}

/// The N lanes of a packet as the first of a tile; directions of zero, which carry no light, after.
fn widen<const N: usize>(direction: &[[f32; N]; 3]) -> Lane3 {
    let mut tile = [[0.0; LANES]; 3];
    for (tile, lanes) in tile.iter_mut().zip(direction) {
        tile[..N].copy_from_slice(lanes);
    }
    tile
}
