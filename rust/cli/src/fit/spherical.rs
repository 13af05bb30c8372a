//! `glimt fit --model spherical`.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use glimt_core::AnyModel;
use glimt_core::directions::healpix::Healpix;
use glimt_core::library::Entry;
use glimt_core::models::spherical::store::StoreKind;
use glimt_core::models::spherical::tables::{self, Form};
use glimt_core::models::spherical::{pixelation, tables::Interpolation};
use glimt_fit::options::SPHERICAL_LOSS;
use glimt_fit::train::Schedule;
use glimt_fit::{Input, Model, Net, Options, SphericalOptions, Truth};

use super::shared::{self, Between, Pairs, Resume, Training};
use crate::Usage;

#[derive(Args)]
pub struct SphericalArguments {
    #[command(flatten)]
    pub pairs: Pairs,
    #[command(flatten)]
    training: Training,
    #[command(flatten)]
    pub resume: Resume,
    #[command(flatten)]
    between: Between,
    /// What the tables are laid over [default: iso if all materials are isotropic, else hd]
    #[arg(long, value_enum, value_name = "GRIDS")]
    grids: Option<Grids>,
    /// N_side of the hemispheres, a power of two: they have 6N² + 6N + 1 points [default: 32; for samples as
    /// many points as there are samples, or nearly]
    #[arg(long, value_name = "N")]
    nside: Option<u16>,
    /// Nodes of each list (--grids iso)
    #[arg(long, value_name = "N", default_value_t = 64)]
    nodes: u16,
    /// Features of a point
    #[arg(long, value_name = "K", default_value = "16", value_parser = features())]
    features: u8,
    /// Keep features as indices of so many bits, 1 to 12, into a codebook; or none
    #[arg(long, value_name = "BITS|none", value_parser = parse_codebook, default_value = "none")]
    codebook: OptionalBits,
    /// How features are kept where there is no codebook
    #[arg(long, value_enum, default_value_t = TableType::I8)]
    table_type: TableType,
    /// How points are laid on hemispheres
    #[arg(long, value_enum, default_value_t = Pixelation::Healpix)]
    pixelation: Pixelation,
    /// Clusters of materials that are alike, each with one network and codebook [default: one per material]
    #[arg(long, value_name = "N")]
    clusters: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Grids {
    /// Light and view hemispheres, as in the paper
    Lv,
    /// Half and difference vectors
    Hd,
    /// For isotropic materials: lists along √θ_h, θ_l and θ_v, and half a hemisphere of difference vectors
    Iso,
}

impl From<Grids> for tables::Grids {
    fn from(grids: Grids) -> tables::Grids {
        match grids {
            Grids::Lv => tables::Grids::Lv,
            Grids::Hd => tables::Grids::Hd,
            Grids::Iso => tables::Grids::Iso,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Pixelation {
    /// Equal areas, found in a few instructions
    Healpix,
    /// Rows and columns, as many as HEALPix has points; for comparisons
    LatLong,
    /// A Fibonacci lattice of as many points; for comparisons
    Fibonacci,
}

impl From<Pixelation> for pixelation::Pixelation {
    fn from(pixelation: Pixelation) -> pixelation::Pixelation {
        match pixelation {
            Pixelation::Healpix => pixelation::Pixelation::Healpix,
            Pixelation::LatLong => pixelation::Pixelation::LatLong,
            Pixelation::Fibonacci => pixelation::Pixelation::Fibonacci,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TableType {
    /// float32
    F32,
    /// float16
    F16,
    /// 8-bit integers
    I8,
    /// 4-bit integers
    I4,
}

fn features() -> impl TypedValueParser<Value = u8> {
    PossibleValuesParser::new(tables::FEATURE_COUNTS.map(|count| count.to_string()))
        .try_map(|text| text.parse::<u8>())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct OptionalBits(Option<u8>);

fn parse_codebook(text: &str) -> Result<OptionalBits, String> {
    let bits =
        if text == "none" { None } else { Some(text.parse().map_err(|_| "expected 1 to 12, or none")?) };
    Ok(OptionalBits(bits))
}

/// Hidden layers of the paper's network.
const NET: Net = Net { width: 64, layers: 2 };

impl SphericalArguments {
    /// The options for `inputs`, and why the grids are what they are.
    ///
    /// # Errors
    /// A number that is out of range, or an interpolation of another model.
    pub fn options(&self, seed: u64, inputs: &[Input]) -> Result<(Options, String), Usage> {
        let anisotropic = inputs.iter().find(|input| !input.isotropic);
        let (best, why) = match anisotropic {
            None => (tables::Grids::Iso, "all materials are isotropic".to_owned()),
            Some(input) => (tables::Grids::Hd, format!("\"{}\" is anisotropic", input.name)),
        };
        let (grids, why) = match self.grids {
            Some(grids) => (grids.into(), "they were asked for".to_owned()),
            None => (best, why),
        };
        let nside = Healpix::try_from(self.nside.unwrap_or_else(|| default_nside(inputs))).map_err(Usage)?;
        let form = Form {
            grids,
            pixelation: self.pixelation.into(),
            nside,
            nodes: self.nodes,
            features: self.features,
            interpolation: self.between.interpolation(interpolation)?,
        };
        let store = match (self.codebook.0, self.table_type) {
            (Some(bits), _) => StoreKind::Codebook(bits),
            (None, TableType::F32) => StoreKind::F32,
            (None, TableType::F16) => StoreKind::F16,
            (None, TableType::I8) => StoreKind::I8,
            (None, TableType::I4) => StoreKind::I4,
        };
        let net = self.training.net.unwrap_or(NET);
        let model = SphericalOptions { form, store, net, clusters: self.clusters, loss: SPHERICAL_LOSS };
        let schedule = self.training.schedule(Schedule::spherical, seed);
        Ok((Options { model: Model::Spherical(model), schedule }, format!("grids {}: {why}", grids.name())))
    }
}

fn interpolation(asked: shared::Interpolation) -> Option<Interpolation> {
    match asked {
        shared::Interpolation::Bilinear => Some(Interpolation::Bilinear),
        shared::Interpolation::InverseDistance => Some(Interpolation::InverseDistance),
        shared::Interpolation::Constant => Some(Interpolation::Constant),
        shared::Interpolation::Nearest | shared::Interpolation::Linear => None,
    }
}

/// As many points as samples, or nearly; where f is known everywhere, what the measurements that are in
/// use can fill.
fn default_nside(inputs: &[Input]) -> u16 {
    const DENSE: u16 = 32;
    let samples = inputs.iter().filter_map(|input| match input.truth {
        Truth::Brdf(_) => None,
        Truth::Samples { f, .. } => Some(f.len()),
    });
    let Some(fewest) = samples.min() else { return DENSE };
    let mut nside = 1;
    while nside < DENSE && Healpix::try_from(2 * nside).is_ok_and(|grid| grid.points() <= fewest) {
        nside *= 2;
    }
    nside
}

/// What was pruned of each material, a line each.
pub fn pruned(entries: &[Entry]) -> String {
    let pruned = |entry: &Entry| match entry.material.model() {
        AnyModel::Spherical(material) if material.features().links.is_some() => {
            let rows = material.layout().places().len();
            let kept = material.features().store.rows(material.layout().form().features.into());
            let pruned = rows - kept;
            Some(format!("{}: {pruned} of {rows} rows that no sample supervises are pruned\n", entry.name))
        }
        _ => None,
    };
    entries.iter().filter_map(pruned).collect()
}
