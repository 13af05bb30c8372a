//! How a material chooses light directions: lobes, a table, or a warp that comes with the measurement.

pub mod lobes;
pub mod table;

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use glam::Vec3;

use crate::brdf::{Brdf, Sample};
use crate::sampling::lobes::Lobes;
use crate::sampling::table::{Resolution, TableSampler};

/// A map from random numbers to light directions that a measurement brings along.
pub trait DirectionSampler: fmt::Debug + Send + Sync {
    /// Density (sr⁻¹) with which [`DirectionSampler::sample_direction`] chooses `light`.
    fn pdf(&self, light: Vec3, view: Vec3) -> f32;

    /// A light direction above the horizon and its density, or `None` for a failed sample. Arguments as
    /// in [`SampleBrdf::sample`](crate::SampleBrdf::sample).
    fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)>;
}

/// The sampler of a material. Whatever it is, its density is exact.
#[derive(Clone, Debug)]
pub enum Sampler {
    /// GGX lobes and a cosine lobe: next to no memory, the same formula in every renderer.
    Lobes(Arc<Lobes>),
    /// Tables of the reflectance itself: hundreds of kilobytes, and close to its shape.
    Table(Arc<TableSampler>),
    /// The measurement's own.
    Warp(Arc<dyn DirectionSampler>),
}

impl Sampler {
    /// The lobes, if it is made of them.
    #[must_use]
    pub fn lobes(&self) -> Option<&Lobes> {
        if let Sampler::Lobes(lobes) = self { Some(lobes) } else { None }
    }

    /// Density (sr⁻¹) of `light` given `view`.
    #[must_use]
    pub fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        match self {
            Sampler::Lobes(lobes) => lobes.pdf(light, view),
            Sampler::Table(table) => table.pdf(light, view),
            Sampler::Warp(warp) => warp.pdf(light, view),
        }
    }

    /// A light direction above the horizon and its density, or `None` for a failed sample. Arguments as
    /// in [`SampleBrdf::sample`](crate::SampleBrdf::sample).
    #[must_use]
    pub fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        match self {
            Sampler::Lobes(lobes) => lobes.sample_direction(view, u),
            Sampler::Table(table) => table.sample_direction(view, u),
            Sampler::Warp(warp) => warp.sample_direction(view, u),
        }
    }

    /// Samples `brdf`, arguments as in [`SampleBrdf::sample`](crate::SampleBrdf::sample).
    #[must_use]
    pub fn sample(&self, brdf: &impl Brdf, view: Vec3, u: Vec3) -> Sample {
        let Some((light, pdf)) = self.sample_direction(view, u) else { return Sample::FAILED };
        let weight = brdf.eval(light, view) * (light.z / pdf);
        // Where f is near the end of float32, the weight can be beyond it.
        if weight.is_finite() { Sample { light, pdf, weight } } else { Sample::FAILED }
    }
}

impl From<Lobes> for Sampler {
    fn from(lobes: Lobes) -> Self {
        Sampler::Lobes(Arc::new(lobes))
    }
}

/// What a material's sampler is to be. It is made when it is first asked for: lobes take milliseconds, tables
/// a quarter of a second, and many a material is never sampled.
#[derive(Clone, Debug)]
pub enum Plan {
    /// [`Sampler::Lobes`].
    Lobes,
    /// [`Sampler::Table`].
    Table(Resolution),
    /// [`Sampler::Warp`].
    Warp(Arc<dyn DirectionSampler>),
}

impl Plan {
    /// The name of the sampler that it plans, as commands and scenes spell it.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Plan::Lobes => "lobes",
            Plan::Table(_) => "table",
            Plan::Warp(_) => "warp",
        }
    }

    /// What to ask for to have it again; `None` for a measurement's own.
    #[must_use]
    pub fn choice(&self) -> Option<SamplerChoice> {
        match self {
            Plan::Lobes => Some(SamplerChoice::Lobes),
            Plan::Table(resolution) => Some(SamplerChoice::Table(*resolution)),
            Plan::Warp(_) => None,
        }
    }

    /// The sampler of `brdf`; `alpha` is the roughness of its analytic part, if it has one.
    pub(crate) fn make(&self, brdf: &impl Brdf, is_isotropic: bool, alpha: Option<[f32; 2]>) -> Sampler {
        match self {
            Plan::Lobes => Lobes::fit(brdf, &lobes::candidates(alpha), is_isotropic).into(),
            Plan::Table(resolution) => {
                Sampler::Table(Arc::new(TableSampler::new(brdf, is_isotropic, *resolution)))
            }
            Plan::Warp(warp) => Sampler::Warp(Arc::clone(warp)),
        }
    }
}

impl From<SamplerChoice> for Plan {
    fn from(choice: SamplerChoice) -> Plan {
        match choice {
            SamplerChoice::Lobes => Plan::Lobes,
            SamplerChoice::Table(resolution) => Plan::Table(resolution),
        }
    }
}

/// A sampler to ask for: `lobes`, `table`, `table:paper`, or `table:VIEWSxRINGSxSECTORS`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SamplerChoice {
    /// [`Sampler::Lobes`].
    Lobes,
    /// [`Sampler::Table`] at some resolution.
    Table(Resolution),
}

impl fmt::Display for SamplerChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SamplerChoice::Lobes => f.write_str("lobes"),
            SamplerChoice::Table(resolution) => write!(f, "table:{resolution}"),
        }
    }
}

impl FromStr for SamplerChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "lobes" => Ok(SamplerChoice::Lobes),
            None if text == "table" => Ok(SamplerChoice::Table(Resolution::DEFAULT)),
            Some(("table", resolution)) => resolution.parse().map(SamplerChoice::Table),
            _ => Err(format!(
                "\"{text}\" is no sampler, expected lobes, table, table:paper or table:VIEWSxRINGSxSECTORS"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read_as_they_are_documented() {
        let table = |views, rings, sectors| {
            SamplerChoice::Table(Resolution { views, rings, sectors, ..Resolution::DEFAULT })
        };
        assert_eq!("lobes".parse(), Ok(SamplerChoice::Lobes));
        assert_eq!("table".parse(), Ok(SamplerChoice::Table(Resolution::DEFAULT)));
        assert_eq!("table:paper".parse(), Ok(SamplerChoice::Table(Resolution::PAPER)));
        assert_eq!("table:16x32x8".parse(), Ok(table(16, 32, 8)));
        for choice in [SamplerChoice::Lobes, SamplerChoice::Table(Resolution::PAPER), table(16, 32, 8)] {
            assert_eq!(choice.to_string().parse(), Ok(choice));
        }
        for wrong in ["tables", "table:", "table:16x32", "table:0x1x1", "table:9999x9999x9999", "lobes:4"] {
            let message = wrong.parse::<SamplerChoice>().unwrap_err();
            assert!(message.contains("expected"), "{message}");
        }
    }
}
