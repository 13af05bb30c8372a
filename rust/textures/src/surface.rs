//! From maps to a material of the core.

use glimt_core::error::Invalid;
use glimt_core::models::maps::{self, Filter, Texel};
use glimt_core::surface::Wrap;

use crate::Maps;

impl Maps {
    /// The texels of a GGX facet under Lambert, row by row from the bottom.
    ///
    /// k_d is (1 − m) base and F₀ is (1 − m) specular + m base, where m is the share of metal; α is the square of the
    /// roughness. With [`Filter::Moments`] the variance of the slopes that a reduction took from the normals is roughness, as
    /// it is in the mips: α² grows by that of both axes. A texel has one α, so that it is the same along all axes.
    pub fn texels(&self, filter: Filter) -> impl Iterator<Item = Texel> + '_ {
        let [width, height] = self.size;
        let rows = (0..height).rev();
        rows.flat_map(move |row| row * width..(row + 1) * width).map(move |i| self.texel(i, filter))
    }

    fn texel(&self, i: usize, filter: Filter) -> Texel {
        let (base, metal) = (self.base_color[i], self.metalness[i]);
        let [x, y, z] = self.normal[i];
        let alpha = self.roughness[i] * self.roughness[i];
        let alpha = match filter {
            Filter::Moments if self.variance[i] > 0.0 => (alpha * alpha + self.variance[i]).sqrt().min(1.0),
            Filter::Moments | Filter::Average | Filter::Fitted => alpha,
        };
        Texel {
            kd: base.map(|base| (1.0 - metal) * base),
            f0: base.map(|base| (1.0 - metal) * self.specular[i] + metal * base),
            alpha,
            // In this order a flat texel has the slope 0, and not −0.
            slope: [0.0 - x / z, 0.0 - y / z],
        }
    }

    /// The material of the maps, whose v goes up as the image does.
    ///
    /// # Errors
    /// Maps that were put together by hand and have no texels.
    pub fn surface(&self, wrap: Wrap, filter: Filter) -> Result<maps::Maps, Invalid> {
        maps::Maps::new(self.size[0], self.texels(filter), wrap, filter)
    }
}
