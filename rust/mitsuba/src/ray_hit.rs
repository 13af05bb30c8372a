//! The way from a kernel that Dr.Jit compiled into the core.
//!
//! Dr.Jit can call out of a compiled kernel in one place: where it traces rays, with the calling convention of
//! Embree's N-wide intersection functions (Embree 3, `rtcIntersect4/8/16`). What we ask poses as rays, and the answers
//! as hits. The material's address is in the fields `id` and `flags`, per lane and as data: a pointer for the scene
//! would be baked into a frozen function.

use std::ffi::c_void;

use glimt_core::Vec3;

use crate::material::Material;

/// Embree's `RTCRayHitN`. What is an integer there and holds an answer is the bits of a float.
#[repr(C)]
pub struct RayHit<const N: usize> {
    pub origin: [[f32; N]; 3],
    pub near: [f32; N],
    pub direction: [[f32; N]; 3],
    pub time: [f32; N],
    pub far: [f32; N],
    pub mask: [u32; N],
    /// The lower half of the material's address.
    pub id: [u32; N],
    /// The upper half of the material's address.
    pub flags: [u32; N],
    pub normal: [[f32; N]; 3],
    /// u, v, and the primitive.
    pub hit: [[f32; N]; 3],
    pub geometry: [f32; N],
    pub instance: [f32; N],
}

impl<const N: usize> RayHit<N> {
    /// The material of a lane.
    ///
    /// # Safety
    ///
    /// The lane is active, so that it holds the address of a live material.
    pub unsafe fn material<'a>(&self, lane: usize) -> &'a Material {
        let address = u64::from(self.flags[lane]) << 32 | u64::from(self.id[lane]);
        // SAFETY: the caller's promise.
        unsafe { &*(address as usize as *const Material) }
    }

    /// The ray's origin in a lane.
    pub fn origin_of(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.origin[c][lane]))
    }

    /// The ray's direction in a lane.
    pub fn direction_of(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.direction[c][lane]))
    }

    /// Answers a vector in u, v and the primitive, and a number in the geometry.
    pub fn answer(&mut self, lane: usize, vector: Vec3, number: f32) {
        for (hit, component) in self.hit.iter_mut().zip(vector.to_array()) {
            hit[lane] = component;
        }
        self.geometry[lane] = number;
    }
}

/// `rtcIntersectN`: per lane −1 (active) or 0, a scene and a context that we have no use for, and the packet.
pub type Intersect<const N: usize> =
    unsafe extern "C" fn(*const i32, *const c_void, *const c_void, *mut RayHit<N>);

/// The address of that one of three functions which serves packets of `width` lanes; 0 where none does.
pub fn address_of_width(
    width: usize,
    four: Intersect<4>,
    eight: Intersect<8>,
    sixteen: Intersect<16>,
) -> usize {
    match width {
        4 => four as usize,
        8 => eight as usize,
        16 => sixteen as usize,
        _ => 0,
    }
}

#[cfg(test)]
impl<const N: usize> RayHit<N> {
    /// Nothing asked and nothing answered, of one material in every lane.
    pub fn of(material: &Material) -> Self {
        let address = &raw const *material as u64;
        let (zero, zeros) = ([0.0; N], [[0.0; N]; 3]);
        RayHit {
            origin: zeros,
            near: zero,
            direction: zeros,
            time: zero,
            far: zero,
            mask: [0; N],
            id: [address as u32; N],
            flags: [(address >> 32) as u32; N],
            normal: zeros,
            hit: [[f32::NAN; N]; 3],
            geometry: [f32::NAN; N],
            instance: [f32::NAN; N],
        }
    }
}
