//! Sampling from inside a kernel that Dr.Jit compiled, for samplers that are not traced, by the way of
//! [`crate::ray_hit`].
//!
//! For a density the ray's origin is the light and its direction the view, and the answer comes back in the hit's u.
//! For a sample the origin holds three random numbers and the direction the view; the light comes back in u, v and
//! primitive, and its density, 0 for a failed sample, in the geometry. (What Dr.Jit reads from the far end of the ray
//! is infinite unless the geometry says that there was a hit.)

use std::ffi::c_void;

use glimt_core::{Sample, SampleBrdf};

use crate::material::guarded;
use crate::ray_hit::{RayHit, address_of_width};

/// Address of the function that answers densities, for packets of `width` lanes; 0 where no such width
/// is served.
pub fn pdf_packet_address(width: usize) -> usize {
    address_of_width(width, pdf_packet::<4>, pdf_packet::<8>, pdf_packet::<16>)
}

/// The same of the function that samples.
pub fn sample_packet_address(width: usize) -> usize {
    address_of_width(width, sample_packet::<4>, sample_packet::<8>, sample_packet::<16>)
}

/// The density of every active lane.
///
/// # Safety
///
/// `valid` points to N numbers, `packet` to a packet that nobody else touches during the call, and
/// the addresses in its active lanes to live materials.
unsafe extern "C" fn pdf_packet<const N: usize>(
    valid: *const i32,
    _scene: *const c_void,
    _context: *const c_void,
    packet: *mut RayHit<N>,
) {
    // SAFETY: the caller's promise.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        // SAFETY: the lane is active.
        let material = unsafe { packet.material(lane) };
        let pdf = || material.material.pdf(packet.origin_of(lane), packet.direction_of(lane));
        packet.hit[0][lane] = guarded(0.0, pdf);
    }
}

/// A sample for every active lane. Arguments and safety as for [`pdf_packet`].
unsafe extern "C" fn sample_packet<const N: usize>(
    valid: *const i32,
    _scene: *const c_void,
    _context: *const c_void,
    packet: *mut RayHit<N>,
) {
    // SAFETY: the caller's promise.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        // SAFETY: the lane is active.
        let material = unsafe { packet.material(lane) };
        let direction = || {
            let (view, u) = (packet.direction_of(lane), packet.origin_of(lane));
            material.material.sampler().sample_direction(view, u)
        };
        let (light, pdf) = guarded(None, direction).unwrap_or((Sample::FAILED.light, 0.0));
        packet.answer(lane, light, pdf);
    }
}
