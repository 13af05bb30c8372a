//! `glimt compare`: how far an image is from the truth.

use std::path::{Path, PathBuf};

use anyhow::Result;
use glimt_image::Image;
use glimt_image::exr::Exr;
use glimt_report::image::difference::Difference;
use glimt_report::image::flip::{Shown, flip};
use glimt_report::image::z_test::{Estimate, ZTest};
use serde::Serialize;

use crate::{inputs, output};

/// Measure how far a rendered image is from the truth: MAE, RMSE, PSNR, SSIM, FLIP, and whether noise explains it
///
/// Both are OpenEXR files of one layer with linear sRGB in R, G, B. If both hold the variance of each pixel's mean
/// in variance.R, variance.G and variance.B, as the harness and tests/harness/render.py write them, a z-test says
/// whether they can be images of one scene, and the command ends with 1 if they cannot.
#[derive(clap::Args)]
pub struct Arguments {
    /// The image to compare with
    #[arg(value_parser = inputs::file())]
    truth: PathBuf,
    /// The image in question
    #[arg(value_parser = inputs::file())]
    image: PathBuf,
    /// Factor on both before they are shown [default: brings 95 % of the truth's values below 1]
    #[arg(long, value_name = "X")]
    exposure: Option<f32>,
    /// Probability with which images of one scene may fail the z-test
    #[arg(long, value_name = "P", default_value_t = 0.001)]
    significance: f64,
    /// Machine-readable
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Comparison {
    #[serde(flatten)]
    difference: Difference,
    flip: f64,
    hdr_flip: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    z_test: Option<ZTest>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let truth = Exr::open(&arguments.truth, "")?;
    let image = Exr::open(&arguments.image, "")?;
    let difference = Difference::measure(&truth, &image, arguments.exposure)?;
    let estimates = (estimate(&arguments.truth), estimate(&arguments.image));
    let comparison = Comparison {
        difference,
        flip: flip(&truth, &image, Shown::Exposed(difference.exposure), |_, _| ())?,
        hdr_flip: flip(&truth, &image, Shown::AllExposures, |_, _| ())?,
        z_test: match estimates {
            (Some(a), Some(b)) => Some(ZTest::compare(&a, &b)?),
            _ => None,
        },
    };
    if arguments.json {
        output::print_raw(&(serde_json::to_string(&comparison)? + "\n"))?;
    } else {
        output::print(&text(&comparison))?;
    }
    match comparison.z_test {
        Some(test) if test.p_value < arguments.significance => anyhow::bail!(
            "{} and {} are not images of one scene: noise alone does this with probability {:.1e}",
            arguments.truth.display(),
            arguments.image.display(),
            test.p_value
        ),
        _ => Ok(()),
    }
}

/// The image with its variance, if the file has one.
fn estimate(path: &Path) -> Option<Estimate> {
    let whole = |prefix: &str| Image::hold(&Exr::open(path, prefix).ok()?).ok();
    Some(Estimate { variance: whole("variance.")?, mean: whole("")? })
}

fn text(comparison: &Comparison) -> String {
    let Difference { mae, rmse, bias, mean, psnr, ssim, exposure, not_finite } = comparison.difference;
    let mut text = format!(
        "MAE {mae:.3e}  RMSE {rmse:.3e}  bias {bias:+.3e}  of a mean of {mean:.3e}\n\
         PSNR {psnr:.2} dB  SSIM {ssim:.5}  FLIP {:.5}  HDR-FLIP {:.5}  at exposure {exposure:.3}\n",
        comparison.flip, comparison.hdr_flip
    );
    if not_finite > 0 {
        text += &format!("{not_finite} pixels are not finite and were left out\n");
    }
    if let Some(test) = comparison.z_test {
        let [x, y, channel] = test.at;
        text += &format!(
            "z-test: largest of {} |z| = {:.2} in {} at ({x}, {y}); whole image {:+.2} {:+.2} {:+.2}; p = {:.2e}\n",
            test.tests,
            test.largest.abs(),
            ["R", "G", "B"][channel],
            test.whole[0],
            test.whole[1],
            test.whole[2],
            test.p_value
        );
    }
    text
}
