//! The options of `glimt fit --model spherical`.

use clap::ValueEnum;
use glimt_core::AnyModel;
use glimt_core::directions::healpix::Healpix;
use glimt_core::library::Entry;
use glimt_core::models::spherical::pixelation::Pixelation;
use glimt_core::models::spherical::store::StoreKind;
use glimt_core::models::spherical::tables::{Form, Grids, Interpolation};
use glimt_fit::options::SPHERICAL_LOSS;
use glimt_fit::{Input, Net, SphericalOptions, Truth};

use crate::fit::parse_variant;

/// Options that mean something for the spherical model only.
#[derive(clap::Args)]
#[command(next_help_heading = "Spherical model")]
pub struct SphericalArguments {
    /// What the tables are laid over: lv, light and view hemispheres, as in the paper; hd, half and difference
    /// vectors; iso, for isotropic materials, lists along √θ_h, θ_l and θ_v and half a hemisphere of difference
    /// vectors [default: iso if all materials are isotropic, else hd]
    #[arg(long, value_parser = parse_variant::<Grids>)]
    grids: Option<Grids>,
    /// N_side of the hemispheres, a power of two: they have 6N² + 6N + 1 points [default: 32; for samples as
    /// many points as there are samples, or nearly]
    #[arg(long, value_name = "N")]
    nside: Option<u16>,
    /// Nodes of each list (iso)
    #[arg(long, value_name = "N", default_value_t = 64)]
    nodes: u16,
    /// Features of a point: 4, 8 or 16
    #[arg(long, value_name = "K", default_value_t = 16)]
    features: u8,
    /// Keep features as indices of so many bits, 1 to 12, into a codebook; or none
    #[arg(long, value_name = "BITS|none", value_parser = parse_codebook, default_value = "none")]
    codebook: OptionalBits,
    /// How features are kept where there is no codebook
    #[arg(long, value_enum, default_value_t = TableType::I8)]
    table_type: TableType,
    /// How points are laid on hemispheres: healpix, or for comparisons lat-long or fibonacci with as many points
    #[arg(long, value_parser = parse_variant::<Pixelation>, default_value = "healpix")]
    pixelation: Pixelation,
    /// Clusters of materials that are alike, each with one network and codebook [default: one per material]
    #[arg(long, value_name = "N")]
    clusters: Option<usize>,
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
    /// In words, a number that is out of range.
    pub fn options(
        &self,
        net: Option<Net>,
        interpolation: Interpolation,
        inputs: &[Input],
    ) -> Result<(SphericalOptions, String), String> {
        let anisotropic = inputs.iter().find(|input| !input.isotropic);
        let (best, why) = match anisotropic {
            None => (Grids::Iso, "all materials are isotropic".to_owned()),
            Some(input) => (Grids::Hd, format!("\"{}\" is anisotropic", input.name)),
        };
        let (grids, why) = match self.grids {
            Some(grids) => (grids, "they were asked for".to_owned()),
            None => (best, why),
        };
        let nside = Healpix::try_from(self.nside.unwrap_or_else(|| default_nside(inputs)))?;
        let form = Form {
            grids,
            pixelation: self.pixelation,
            nside,
            nodes: self.nodes,
            features: self.features,
            interpolation,
        };
        let store = match (self.codebook.0, self.table_type) {
            (Some(bits), _) => StoreKind::Codebook(bits),
            (None, TableType::F32) => StoreKind::F32,
            (None, TableType::F16) => StoreKind::F16,
            (None, TableType::I8) => StoreKind::I8,
            (None, TableType::I4) => StoreKind::I4,
        };
        let net = net.unwrap_or(NET);
        let options = SphericalOptions { form, store, net, clusters: self.clusters, loss: SPHERICAL_LOSS };
        Ok((options, format!("grids {}: {why}", grids.name())))
    }

    /// Names of the options that were given.
    pub fn given(&self) -> [(&'static str, bool); 8] {
        [
            ("--grids", self.grids.is_some()),
            ("--nside", self.nside.is_some()),
            ("--nodes", self.nodes != 64),
            ("--features", self.features != 16),
            ("--codebook", self.codebook.0.is_some()),
            ("--table-type", self.table_type != TableType::I8),
            ("--pixelation", self.pixelation != Pixelation::Healpix),
            ("--clusters", self.clusters.is_some()),
        ]
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

/// What there is to say of a fit besides its errors: why the grids are what they are, and what was pruned.
pub fn notes(why: Option<String>, entries: &[Entry]) -> String {
    let pruned = |entry: &Entry| match entry.material.model() {
        AnyModel::Spherical(material) if material.features().links.is_some() => {
            let rows = material.layout().places().len();
            let kept = material.features().store.rows(material.layout().form().features.into());
            let pruned = rows - kept;
            Some(format!("{}: {pruned} of {rows} rows that no sample supervises are pruned\n", entry.name))
        }
        _ => None,
    };
    why.map(|why| why + "\n").into_iter().chain(entries.iter().filter_map(pruned)).collect()
}
