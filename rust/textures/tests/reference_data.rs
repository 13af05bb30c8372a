//! Sets as they are downloaded: run with `--ignored` where `../shared/data/svbrdf` is.

use std::path::PathBuf;

use glimt_textures::{Finding, Folder, MEMORY, Maps, Size};

fn set(material: &str, size: Size) -> Maps {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/svbrdf");
    let folder = Folder::open_material(path, material).unwrap();
    for finding in folder.findings() {
        println!("{finding}");
    }
    let maps = folder.maps(size, MEMORY).unwrap();
    for finding in &maps.findings {
        println!("{finding}");
    }
    maps
}

/// Both sets' normal maps are named `_Normal`, and are DirectX's by their heights.
fn is_turned(maps: &Maps) -> bool {
    maps.findings.iter().any(|finding| matches!(finding, Finding::Green { is_up: Some(false), .. }))
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&x| f64::from(x)).sum::<f64>() / values.len() as f64
}

#[test]
#[ignore = "reference data"]
fn reference_data_of_metal_plates() {
    let maps = set("MetalPlates006", Size::Own);
    assert_eq!(maps.size, [1024, 1024]);
    let tilt: Vec<f32> = maps.normal.iter().map(|n| n[2].acos().to_degrees()).collect();
    println!("mean roughness {:.3}, mean tilt {:.2}°", mean(&maps.roughness), mean(&tilt));
    assert!((mean(&maps.roughness) - 0.3).abs() < 0.05 && mean(&tilt) < 15.0);
    assert!(mean(&maps.metalness) > 0.9);
    assert!(is_turned(&maps));
}

#[test]
#[ignore = "reference data"]
fn reference_data_of_wood() {
    let maps = set("Wood047", Size::LongestSide(256));
    assert_eq!(maps.size, [256, 128]);
    assert!(maps.metalness.iter().all(|&x| x == 0.0));
    assert!(is_turned(&maps));
    // A tile that closes is flat in the mean.
    let slope = |i: usize| mean(&maps.normal.iter().map(|n| n[i] / n[2]).collect::<Vec<f32>>());
    println!("mean slope {:.4}, {:.4}", slope(0), slope(1));
    assert!(slope(0).abs() < 0.02 && slope(1).abs() < 0.02);
}
