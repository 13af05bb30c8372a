//! Where commands look at a surface.

use std::str::FromStr;

use anyhow::{Result, bail};
use glimt_core::Material;
use glimt_core::material::At;
use glimt_core::surface::{Footprint, Place};

/// A place on a surface. A material that is the same everywhere asks for none, and takes any.
#[derive(clap::Args, Clone, Copy)]
pub struct PlaceArguments {
    /// Where to look at a surface: texture coordinates, u to the right and v up, of which a tile is [0, 1)²; other
    /// materials are the same everywhere
    #[arg(long, value_name = "U,V", allow_hyphen_values = true)]
    uv: Option<Uv>,
    /// How much of the surface is seen around --uv: the standard deviation of a Gaussian in texture coordinates, or
    /// dudx,dvdx,dudy,dvdy, the two axes that it has; inf is all of it from afar, and needs no --uv [default: a point]
    #[arg(long, value_name = "SIGMA", allow_hyphen_values = true)]
    footprint: Option<Extent>,
}

impl PlaceArguments {
    /// The place that was asked for, if one was.
    #[must_use]
    pub fn place(&self) -> Option<Place> {
        let footprint = self.footprint.map_or(Footprint::Point, |extent| extent.0);
        match self.uv {
            Some(Uv(uv)) => Some(Place { uv, footprint }),
            None => (footprint == Footprint::Isotropic(f32::INFINITY)).then(Place::far),
        }
    }

    /// Whether one of the options was given.
    #[must_use]
    pub fn is_given(&self) -> bool {
        self.uv.is_some() || self.footprint.is_some()
    }

    /// What `material` reflects there.
    ///
    /// # Errors
    /// A surface, and no place.
    pub fn look<'a>(&self, name: &str, material: &'a Material) -> Result<At<'a>> {
        if !material.is_surface() {
            return Ok(At::Everywhere(material));
        }
        let Some(place) = self.place() else {
            bail!(
                "\"{name}\" is a surface, another material at every place: name one with --uv U,V and, for what more \
                 than a point reflects, --footprint SIGMA; --footprint inf alone is all of it from afar"
            )
        };
        Ok(material.at(&place))
    }
}

/// Refuses a sampler for a surface, which has one of its own at every place.
///
/// # Errors
/// Names the material.
pub fn refuse_sampler(name: &str, material: &Material, is_given: bool) -> Result<()> {
    if is_given && material.is_surface() {
        bail!("\"{name}\" is a surface, which has a sampler of its own at every place: leave out --sampler");
    }
    Ok(())
}

/// Texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Uv([f32; 2]);

impl FromStr for Uv {
    type Err = String;

    fn from_str(text: &str) -> Result<Uv, String> {
        match numbers(text)?[..] {
            [u, v] if u.is_finite() && v.is_finite() => Ok(Uv([u, v])),
            [_, _] => Err("expected numbers that are finite".into()),
            ref other => Err(format!("found {} numbers, expected U,V", other.len())),
        }
    }
}

/// A footprint as the command line spells it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extent(Footprint);

impl FromStr for Extent {
    type Err = String;

    fn from_str(text: &str) -> Result<Extent, String> {
        let numbers = numbers(text)?;
        if numbers.iter().any(|number| number.is_nan()) {
            return Err("expected numbers".into());
        }
        match numbers[..] {
            [sigma] if sigma >= 0.0 => Ok(Extent(Footprint::Isotropic(sigma))),
            [sigma] => Err(format!("found {sigma}, expected a standard deviation of at least 0")),
            [a, b, c, d] => Ok(Extent(Footprint::Axes([[a, b], [c, d]]))),
            ref other => Err(format!("found {} numbers, expected SIGMA or dudx,dvdx,dudy,dvdy", other.len())),
        }
    }
}

fn numbers(text: &str) -> Result<Vec<f32>, String> {
    let number = |number: &str| number.trim().parse().map_err(|_| format!("\"{number}\" is not a number"));
    text.split(',').map(number).collect()
}

/// A place in words.
#[must_use]
pub fn spelled(place: &Place) -> String {
    let [u, v] = place.uv;
    match place.footprint {
        Footprint::Point => format!("at {u},{v}"),
        Footprint::Isotropic(f32::INFINITY) => "from afar".into(),
        Footprint::Isotropic(sigma) => format!("at {u},{v} footprint {sigma}"),
        Footprint::Axes([[a, b], [c, d]]) => format!("at {u},{v} footprint {a},{b},{c},{d}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_read_as_they_are_documented() {
        assert_eq!("0.3,-7".parse(), Ok(Uv([0.3, -7.0])));
        assert_eq!("0.01".parse(), Ok(Extent(Footprint::Isotropic(0.01))));
        assert_eq!("inf".parse(), Ok(Extent(Footprint::Isotropic(f32::INFINITY))));
        let axes = Footprint::Axes([[0.1, 0.0], [0.0, -0.2]]);
        assert_eq!("0.1, 0, 0,-0.2".parse(), Ok(Extent(axes)));
        for (text, part) in [("0.3", "1 numbers"), ("inf,0", "finite"), ("a,b", "\"a\"")] {
            assert!(text.parse::<Uv>().unwrap_err().contains(part), "{text}");
        }
        for (text, part) in [("-1", "at least 0"), ("nan", "expected numbers"), ("1,2", "2 numbers")] {
            assert!(text.parse::<Extent>().unwrap_err().contains(part), "{text}");
        }
    }
}
