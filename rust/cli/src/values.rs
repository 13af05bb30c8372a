//! Values of options that several commands take.

use std::str::FromStr;

use clap::ValueEnum;
use glimt_core::surface::Precision;
use glimt_fit::Net;

/// In how many bits the texels of a surface are kept.
#[derive(Clone, Copy, ValueEnum)]
pub enum PrecisionName {
    /// float32
    F32,
    /// float16
    F16,
    /// 256 steps over the range of each channel
    U8,
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Precision {
        match name {
            PrecisionName::F32 => Precision::F32,
            PrecisionName::F16 => Precision::F16,
            PrecisionName::U8 => Precision::U8,
        }
    }
}

/// A size of a network as the command line spells it.
///
/// # Errors
/// In words, another spelling or size.
pub fn parse_net(text: &str) -> Result<Net, String> {
    let parts = text.split_once('x').and_then(|(width, layers)| {
        Some(Net { width: usize::from_str(width).ok()?, layers: usize::from_str(layers).ok()? })
    });
    let net = parts.ok_or_else(|| "expected width times layers, as in 32x2".to_owned())?;
    if net.is_supported() { Ok(net) } else { Err("expected 16, 32 or 64 times 2 or 3".to_owned()) }
}
