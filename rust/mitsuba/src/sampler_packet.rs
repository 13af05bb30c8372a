//! Sampling from inside a kernel that Dr.Jit compiled, for samplers that are not traced.
//!
//! The same way in as [`crate::packet`]: the convention of Embree's N-wide intersection functions, with
//! the material's address in the fields `id` and `flags`. For a density the ray's origin is the light
//! and its direction the view, and the answer comes back in the hit's u. For a sample the origin holds
//! three random numbers and the direction the view; the light comes back in u, v and primitive, and its
//! density, 0 for a failed sample, in the geometry: the last two as the bits of a float. (What Dr.Jit reads
//! from the far end of the ray is infinite unless the geometry says that there was a hit.)

use std::ffi::c_void;

use glimt_core::{Sample, SampleBrdf, Vec3};

use crate::material::{Material, guarded};

/// Embree's `RTCRayHitN` with our values in its fields.
#[repr(C)]
struct Packet<const N: usize> {
    origin: [[f32; N]; 3],
    _near: [f32; N],
    view: [[f32; N]; 3],
    _time: [f32; N],
    _far: [f32; N],
    _mask: [u32; N],
    address_low: [u32; N],
    address_high: [u32; N],
    _normal: [[f32; N]; 3],
    answer: [[f32; N]; 3],
    density: [f32; N],
    _instance: [u32; N],
}

type Function<const N: usize> =
    unsafe extern "C" fn(*const i32, *const c_void, *const c_void, *mut Packet<N>);

/// Address of the function that answers densities, for packets of `width` lanes; 0 where no such width
/// is served.
pub fn pdf_packet_address(width: usize) -> usize {
    match width {
        4 => pdf_packet::<4> as Function<4> as usize,
        8 => pdf_packet::<8> as Function<8> as usize,
        16 => pdf_packet::<16> as Function<16> as usize,
        _ => 0,
    }
}

/// The same of the function that samples.
pub fn sample_packet_address(width: usize) -> usize {
    match width {
        4 => sample_packet::<4> as Function<4> as usize,
        8 => sample_packet::<8> as Function<8> as usize,
        16 => sample_packet::<16> as Function<16> as usize,
        _ => 0,
    }
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
    packet: *mut Packet<N>,
) {
    // SAFETY: the caller's promise.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        // SAFETY: the lane is active.
        let material = unsafe { packet.material(lane) };
        let pdf = || material.material.pdf(lane_of(&packet.origin, lane), lane_of(&packet.view, lane));
        packet.answer[0][lane] = guarded(0.0, pdf);
    }
}

/// A sample for every active lane. Arguments and safety as for [`pdf_packet`].
unsafe extern "C" fn sample_packet<const N: usize>(
    valid: *const i32,
    _scene: *const c_void,
    _context: *const c_void,
    packet: *mut Packet<N>,
) {
    // SAFETY: the caller's promise.
    let (valid, packet) = unsafe { (&*valid.cast::<[i32; N]>(), &mut *packet) };
    for lane in (0..N).filter(|&lane| valid[lane] != 0) {
        // SAFETY: the lane is active.
        let material = unsafe { packet.material(lane) };
        let direction = || {
            material
                .material
                .sampler()
                .sample_direction(lane_of(&packet.view, lane), lane_of(&packet.origin, lane))
        };
        let (light, pdf) = guarded(None, direction).unwrap_or((Sample::FAILED.light, 0.0));
        for (answer, component) in packet.answer.iter_mut().zip(light.to_array()) {
            answer[lane] = component;
        }
        packet.density[lane] = pdf;
    }
}

impl<const N: usize> Packet<N> {
    /// The material of a lane.
    ///
    /// # Safety
    ///
    /// The lane is active, so that it holds the address of a live material.
    unsafe fn material<'a>(&self, lane: usize) -> &'a Material {
        let address = u64::from(self.address_high[lane]) << 32 | u64::from(self.address_low[lane]);
        // SAFETY: the caller's promise.
        unsafe { &*(address as usize as *const Material) }
    }
}

fn lane_of<const N: usize>(values: &[[f32; N]; 3], lane: usize) -> Vec3 {
    Vec3::new(values[0][lane], values[1][lane], values[2][lane])
}
