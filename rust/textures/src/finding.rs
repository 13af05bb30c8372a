//! What was made of the files, for whoever wants to know.

use std::fmt;

use serde::Serialize;

/// A parameter of the material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Map {
    /// Diffuse albedo of what is no metal, reflectance at normal incidence of what is.
    BaseColor,
    /// Perceptual roughness.
    Roughness,
    /// Share of metal.
    Metalness,
    /// Directions of the surface.
    Normal,
    /// Reflectance at normal incidence of what is no metal.
    Specular,
}

impl fmt::Display for Map {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Map::BaseColor => "colour",
            Map::Roughness => "roughness",
            Map::Metalness => "metalness",
            Map::Normal => "normals",
            Map::Specular => "specular reflectance",
        })
    }
}

/// Something that was found, or done for lack of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Finding {
    /// A parameter comes from a file.
    Taken {
        /// The parameter.
        map: Map,
        /// The file's name.
        file: String,
        /// Its width and height.
        size: [usize; 2],
        /// How it is read.
        how: String,
    },
    /// A parameter is the same everywhere, because no map was found for it.
    Filled {
        /// The parameter.
        map: Map,
        /// What it is.
        value: String,
    },
    /// A file, or something in it, has no effect.
    Unused {
        /// The file's name.
        file: String,
        /// Why.
        why: String,
    },
    /// A map had another size than the others, or than was asked for.
    Resized {
        /// The parameter.
        map: Map,
        /// The file's name.
        file: String,
        /// Its width and height.
        from: [usize; 2],
        /// The width and height that it has now.
        to: [usize; 2],
    },
    /// Heights said which way the green channel of a normal map points, as its name did not.
    Green {
        /// The normal map.
        file: String,
        /// The map of heights.
        heights: String,
        /// Where it points; `None` if the heights do not say it either, so that it is taken to point up.
        is_up: Option<bool>,
    },
    /// Texels that are read otherwise than they stand there.
    Odd {
        /// The parameter.
        map: Map,
        /// The file's name.
        file: String,
        /// What is odd.
        what: Oddity,
        /// How many texels.
        count: u64,
        /// How many texels the image has.
        of: u64,
    },
}

/// What is odd about a texel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Oddity {
    /// Below 0 or above 1.
    OutOfRange,
    /// Not a number, or infinite.
    NotFinite,
    /// A normal whose length is far from 1.
    Length,
    /// A normal below the surface, or almost in it.
    Steep,
    /// Channels that differ in an image of one quantity.
    Colored,
    /// Alpha below 1.
    Transparent,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Finding::Taken { map, file, size: [width, height], how } => {
                write!(f, "{map}: {file}, {width} × {height} texels, {how}")
            }
            Finding::Filled { map, value } => write!(f, "{map}: no map, {value}"),
            Finding::Unused { file, why } => write!(f, "{file} is not used: {why}"),
            Finding::Resized { map, file, from, to } => {
                write!(f, "{map}: {file} is resized from {} × {} to {} × {}", from[0], from[1], to[0], to[1])
            }
            Finding::Green { file, heights, is_up } => {
                let points = match is_up {
                    Some(true) => "points up (GL), by the heights in",
                    Some(false) => "points down (DX) and is turned up, by the heights in",
                    None => "is taken to point up (GL): nothing is said by",
                };
                write!(f, "normals: the green channel of {file} {points} {heights}")
            }
            Finding::Odd { map, file, what, count, of } => {
                write!(f, "{map}: {count} of {of} texels of {file} {what}")
            }
        }
    }
}

impl fmt::Display for Oddity {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Oddity::OutOfRange => "are below 0 or above 1, taken as 0 or 1",
            Oddity::NotFinite => "are not finite, taken as where there is no map",
            Oddity::Length => "have a length far from 1, made 1",
            Oddity::Steep => "are steeper than 86°, or below the surface, taken as 86° steep",
            Oddity::Colored => "are coloured, of which the red channel is taken",
            Oddity::Transparent => "are transparent, taken as opaque",
        })
    }
}
