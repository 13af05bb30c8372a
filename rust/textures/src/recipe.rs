//! How each parameter comes from images. Where there is no image, its texels count as 1.

use std::sync::Arc;

use crate::finding::{Finding, Map};
use crate::image::{Format, Image};
use crate::{Error, names::Green};

/// A channel of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Channel {
    Red,
    Green,
    Blue,
    Alpha,
}

/// The colour: `factor` × the image.
#[derive(Clone, Debug)]
pub(crate) struct Color {
    pub(crate) image: Option<Arc<Image>>,
    pub(crate) factor: [f32; 3],
}

/// One number: `offset` + `scale` × a channel of the image.
#[derive(Clone, Debug)]
pub(crate) struct Scalar {
    pub(crate) image: Option<Arc<Image>>,
    pub(crate) channel: Channel,
    pub(crate) scale: f32,
    pub(crate) offset: f32,
}

impl Scalar {
    pub(crate) fn constant(value: f32) -> Self {
        Scalar { image: None, channel: Channel::Red, scale: value, offset: 0.0 }
    }

    pub(crate) fn of(image: Arc<Image>, channel: Channel, scale: f32) -> Self {
        Scalar { image: Some(image), channel, scale, offset: 0.0 }
    }
}

/// The normals, flat without an image; their slopes are multiplied by `scale`.
#[derive(Clone, Debug)]
pub(crate) struct Normals {
    pub(crate) image: Option<Arc<Image>>,
    pub(crate) green: Green,
    /// Heights that say what the name does not.
    pub(crate) heights: Option<Arc<Image>>,
    pub(crate) scale: f32,
}

/// All parameters.
#[derive(Clone, Debug)]
pub(crate) struct Recipe {
    pub(crate) base_color: Color,
    pub(crate) roughness: Scalar,
    pub(crate) metalness: Scalar,
    pub(crate) normal: Normals,
    pub(crate) specular: Scalar,
}

/// Reflectance at normal incidence for the index of refraction 1.5, which all sources assume.
pub(crate) const SPECULAR: f32 = 0.04;

impl Recipe {
    /// What is assumed where there is no map: half rough, as Disney's and Blender's principled materials are, and no
    /// metal.
    pub(crate) fn plain() -> Self {
        Recipe {
            base_color: Color { image: None, factor: [1.0; 3] },
            roughness: Scalar::constant(0.5),
            metalness: Scalar::constant(0.0),
            normal: Normals { image: None, green: Green::Up, heights: None, scale: 1.0 },
            specular: Scalar::constant(SPECULAR),
        }
    }

    /// The images that are used, one for each map that has one.
    pub(crate) fn images(&self) -> impl Iterator<Item = (Map, &Arc<Image>)> {
        [
            (Map::BaseColor, &self.base_color.image),
            (Map::Roughness, &self.roughness.image),
            (Map::Metalness, &self.metalness.image),
            (Map::Normal, &self.normal.image),
            (Map::Specular, &self.specular.image),
        ]
        .into_iter()
        .filter_map(|(map, image)| Some((map, image.as_ref()?)))
    }

    /// Whether the images can be what they are taken for, by their headers.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if let Some(image) = self.normal.image.as_ref().filter(|image| image.is_grey()) {
            return Err(too_few(image, Map::Normal));
        }
        for (map, scalar) in [(Map::Roughness, &self.roughness), (Map::Metalness, &self.metalness)] {
            let is_packed = matches!(scalar.channel, Channel::Green | Channel::Blue);
            if let Some(image) = scalar.image.as_ref().filter(|image| is_packed && image.is_grey()) {
                return Err(too_few(image, map));
            }
        }
        let Some(largest) = self.largest() else { return Ok(()) };
        match self.images().find(|(_, image)| !is_same_shape(image.size, largest.size)) {
            None => Ok(()),
            Some((_, image)) => Err(Error::Shape {
                path: image.path().to_owned(),
                size: image.size,
                other: largest.path().to_owned(),
                other_size: largest.size,
            }),
        }
    }

    /// The image of most texels, the first of equals.
    pub(crate) fn largest(&self) -> Option<&Arc<Image>> {
        self.images().map(|(_, image)| image).reduce(|a, b| if b.texels() > a.texels() { b } else { a })
    }

    /// What is taken and filled in.
    pub(crate) fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        let color = |image: &Image| match image.format {
            Format::Exr => "linear".to_owned(),
            _ => "sRGB".to_owned(),
        };
        say(&mut findings, Map::BaseColor, &self.base_color.image, color, || {
            let [r, g, b] = self.base_color.factor;
            format!("{r}, {g}, {b} everywhere")
        });
        for (map, scalar) in [(Map::Roughness, &self.roughness), (Map::Metalness, &self.metalness)] {
            say(
                &mut findings,
                map,
                &scalar.image,
                |_| scalar.how(),
                || format!("{} everywhere", scalar.scale),
            );
        }
        let green = |_: &Image| match (self.normal.green, &self.normal.heights) {
            (Green::Up, _) => "green points up (GL)".to_owned(),
            (Green::Down, _) => "green points down (DX), turned up".to_owned(),
            (Green::Unsaid, None) => "green taken to point up (GL), which its name does not say".to_owned(),
            (Green::Unsaid, Some(heights)) => format!("green points as {} says", heights.file()),
        };
        say(&mut findings, Map::Normal, &self.normal.image, green, || "flat everywhere".to_owned());
        let scalar = &self.specular;
        say(
            &mut findings,
            Map::Specular,
            &scalar.image,
            |_| scalar.how(),
            || format!("{} everywhere", scalar.scale),
        );
        findings
    }
}

impl Scalar {
    fn how(&self) -> String {
        let channel = match self.channel {
            Channel::Red => "linear",
            Channel::Green => "its green channel",
            Channel::Blue => "its blue channel",
            Channel::Alpha => "its alpha",
        };
        match (self.offset, self.scale) {
            (0.0, 1.0) => channel.to_owned(),
            (0.0, scale) => format!("{channel}, times {scale}"),
            (offset, _) => format!("{channel}, {offset} minus it"),
        }
    }
}

fn say(
    findings: &mut Vec<Finding>,
    map: Map,
    image: &Option<Arc<Image>>,
    how: impl Fn(&Image) -> String,
    value: impl Fn() -> String,
) {
    findings.push(match image {
        None => Finding::Filled { map, value: value() },
        Some(image) => {
            let how = format!("{}, {}, {}", image.depth, image.format, how(image));
            Finding::Taken { map, file: image.file(), size: image.size, how }
        }
    });
}

fn too_few(image: &Image, map: Map) -> Error {
    Error::Channels { path: image.path().to_owned(), map, found: image.kind(), expected: "three channels" }
}

/// Whether two images cover the same square of texture coordinates, but for rounding; a single texel covers any.
pub(crate) fn is_same_shape(a: [usize; 2], b: [usize; 2]) -> bool {
    let (across, along) = (a[0] as f64 * b[1] as f64, a[1] as f64 * b[0] as f64);
    a == [1, 1] || b == [1, 1] || (across - along).abs() <= 0.02 * across.max(along)
}
