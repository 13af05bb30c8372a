//! `glimt compare` as a process.

mod common;

use common::Folder;
use glimt_image::Image;
use glimt_image::exr::write;

/// A ramp with as much noise as its variance says, and the variance.
fn noisy(folder: &Folder, name: &str, seed: usize, factor: f32) {
    // A Weyl sequence through the inverse of a triangle's distribution: mean 0, variance 1/6.
    let noise = |i: usize| {
        let u =
            ((i + seed) as f64 * 0.618_033_988_75).fract() + ((i * 7 + seed) as f64 * 0.414_213_562).fract();
        (u - 1.0) as f32
    };
    let pixel = |i: usize| [factor * (1.0 + 0.001 * i as f32) + 0.05 * noise(i); 3];
    let image = Image::new(64, (0..64 * 64).map(pixel).collect());
    let variance = Image::new(64, vec![[0.05 * 0.05 / 6.0; 3]; 64 * 64]);
    write(&folder.path(name), &[("", &image), ("variance.", &variance)]).unwrap();
}

#[test]
fn noise_passes_and_an_error_does_not() {
    let folder = Folder::new();
    noisy(&folder, "truth.exr", 0, 1.0);
    noisy(&folder, "again.exr", 12_345, 1.0);
    noisy(&folder, "wrong.exr", 54_321, 1.05);
    let table = folder.succeeds(&["compare", "truth.exr", "again.exr"]);
    assert!(table.contains("PSNR") && table.contains("z-test: largest of 768"), "{table}");
    let wrong = folder.command(&["compare", "truth.exr", "wrong.exr"]).output().unwrap();
    let message = String::from_utf8(wrong.stderr).unwrap();
    assert!(wrong.status.code() == Some(1) && message.contains("not images of one scene"), "{message}");
}

#[test]
fn json_holds_every_figure() {
    let folder = Folder::new();
    noisy(&folder, "truth.exr", 0, 1.0);
    let json = folder.succeeds(&["compare", "truth.exr", "truth.exr", "--json", "--exposure", "0.5"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((json["mae"].as_f64(), json["exposure"].as_f64()), (Some(0.0), Some(0.5)));
    for figure in ["rmse", "ssim", "flip", "hdr_flip", "z_test"] {
        assert!(!json[figure].is_null(), "{figure} in {json}");
    }
}

#[test]
fn an_image_that_cannot_be_read_is_named() {
    let folder = Folder::new();
    let message = folder.fails(1, &["compare", "none.exr", "none.exr"]);
    assert!(message.contains("none.exr"), "{message}");
}
