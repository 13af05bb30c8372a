//! Surfaces at the command line: from folders of texture maps to answers at a place.

mod common;

use common::Folder;
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::models::maps::{Filter, Maps, Texel};
use glimt_core::surface::{Footprint, Place, Wrap};
use glimt_core::{Brdf, Library, Material, SampleBrdf, Vec3};
use glimt_files::{Array, sha256, sha256_of};

/// A PNG of 8 bits from the channels of each texel.
fn png<const N: usize>(size: [u32; 2], texel: impl Fn(u32, u32) -> [u8; N]) -> Vec<u8> {
    let all = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
    let data: Vec<u8> = all.flat_map(|(x, y)| texel(x, y)).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(if N == 1 { png::ColorType::Grayscale } else { png::ColorType::Rgb });
    encoder.write_header().unwrap().write_image_data(&data).unwrap();
    bytes
}

/// The header of a PNG of any size.
fn png_that_claims(side: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side, side);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_chunk(png::chunk::IDAT, &[0x78, 0x9c, 0, 0]).unwrap();
    drop(writer);
    bytes
}

/// A folder with a folder of maps, which are a tile of 4 × 4 texels.
struct Set(Folder);

impl Set {
    fn new() -> Set {
        let set = Set(Folder::new());
        std::fs::create_dir(set.0.path("wood")).unwrap();
        set.map("Color", &png([4, 4], |x, y| [200 - 10 * x as u8, 60 + 40 * y as u8, 90]));
        set.map("Roughness", &png([4, 4], |x, y| [(90 + 30 * ((x + y) % 3)) as u8]));
        set.map("Metalness", &png([4, 4], |x, y| [if (x + y) % 2 == 0 { 255 } else { 0 }]));
        set.map("NormalGL", &png([4, 4], |x, y| [108 + 20 * (x % 3) as u8, 138 - 10 * (y % 4) as u8, 250]));
        set
    }

    fn map(&self, kind: &str, bytes: &[u8]) {
        std::fs::write(self.0.path(&format!("wood/Wood_1K-PNG_{kind}.png")), bytes).unwrap();
    }

    /// `wood.safetensors`, and what was said.
    fn converted(&self, more: &[&str]) -> (Library, String) {
        let said = self.0.succeeds(&[&["convert", "wood", "-o", "wood.safetensors"], more].concat());
        (Library::open(self.0.path("wood.safetensors")).unwrap(), said)
    }

    fn f(&self, arguments: &[&str]) -> Vec<f32> {
        self.0.succeeds(&[&["eval"], arguments, &["--pairs", "pairs.npy", "-o", "f.npy"]].concat());
        Array::open(self.0.path("f.npy")).unwrap().values
    }
}

fn maps_of(library: &Library) -> &Maps {
    library.material(None).unwrap().try_into().unwrap()
}

/// The homogeneous material of a texel's numbers.
fn ggx_of(texel: &Texel) -> Ggx {
    let eta = texel.f0.map(|f0| (1.0 + f0.sqrt()) / (1.0 - f0.sqrt()));
    Ggx::new(Microfacet { kd: texel.kd, eta, alpha: [texel.alpha; 2] }).unwrap()
}

const LIGHT: Vec3 = Vec3::new(-0.6, 0.0, 0.8);
const VIEW: Vec3 = Vec3::new(0.6, 0.0, 0.8);

#[test]
fn a_texel_of_the_image_is_its_ggx_in_the_frame_of_its_normal() {
    let set = Set::new();
    let (library, said) = set.converted(&[]);
    assert_eq!(library.names(), ["Wood"]);
    assert!(said.contains("colour: Wood_1K-PNG_Color.png, 4 × 4 texels, 8 bits, PNG, sRGB"), "{said}");
    assert!(said.contains("specular reflectance: no map, 0.04 everywhere"), "{said}");
    let maps = maps_of(&library);
    assert_eq!((maps.size(), maps.wrap(), maps.filter()), ([4, 4], Wrap::Repeat, Filter::Moments));
    for (column, row) in [(0, 0), (2, 1), (3, 3)] {
        // Rows go up, those of images down.
        let texel = maps.texel(column, row);
        let srgb = |code: f64| ((code / 255.0 + 0.055) / 1.055).powf(2.4) as f32;
        let [x, y] = [column as u32, 3 - row as u32];
        let green = srgb(f64::from(60 + 40 * y));
        let (kd, f0) = if (x + y) % 2 == 0 { (0.0, green) } else { (green, 0.04) };
        assert!((texel.kd[1] - kd).abs() < 1e-5 && (texel.f0[1] - f0).abs() < 1e-5, "{texel:?} {green}");
        let roughness = (90 + 30 * ((x + y) % 3)) as f32 / 255.0;
        assert!((texel.alpha - roughness * roughness).abs() < 1e-6);

        let uv = format!("{},{}", (column as f32 + 0.5) / 4.0, (row as f32 + 0.5) / 4.0);
        let f = set.f(&["wood.safetensors", "--uv", &uv]);
        let normal = Vec3::new(-texel.slope[0], -texel.slope[1], 1.0).normalize();
        let tangent = (Vec3::X - normal * normal.x).normalize();
        let frame = [tangent, normal.cross(tangent), normal];
        let [light, view] = [LIGHT, VIEW].map(|v| Vec3::from(frame.map(|axis| axis.dot(v))));
        let expected = ggx_of(&texel).eval(light, view) * (light.z / LIGHT.z);
        let found = Vec3::from_slice(&f[3..]);
        assert!((found - expected).abs().max_element() < 1e-4 * expected.max_element(), "{found} {expected}");
        assert_eq!(f[6..], [0.0; 3]);
    }
}

#[test]
fn constant_maps_are_the_homogeneous_material_to_the_bit() {
    let set = Set::new();
    set.map("Color", &png([4, 4], |_, _| [200, 100, 30]));
    set.map("Roughness", &png([4, 4], |_, _| [120]));
    for kind in ["Metalness", "NormalGL"] {
        std::fs::remove_file(set.0.path(&format!("wood/Wood_1K-PNG_{kind}.png"))).unwrap();
    }
    let (library, said) = set.converted(&[]);
    assert!(
        said.contains("metalness: no map, 0 everywhere") && said.contains("normals: no map, flat"),
        "{said}"
    );
    let ggx = Material::from(ggx_of(&maps_of(&library).texel(1, 2)));
    let entry = Entry { name: "flat".into(), material: ggx, origin: Origin::default() };
    Library::new(set.0.path("flat.safetensors"), vec![entry]).unwrap().save().unwrap();
    let expected = set.f(&["flat.safetensors"]);
    assert!(expected[3] > 0.0);
    for place in
        [&["--uv", "0.3,0.8"][..], &["--uv", "-3.21,0.5", "--footprint", "0.2"], &["--footprint", "inf"]]
    {
        assert_eq!(set.f(&[&["wood.safetensors"], place].concat()), expected, "{place:?}");
    }
}

#[test]
fn commands_look_at_the_place_that_is_named() {
    let set = Set::new();
    let (library, _) = set.converted(&[]);
    let material = library.material(None).unwrap();
    let axes = Footprint::Axes([[0.2, 0.1], [-0.05, 0.1]]);
    let places = [
        (&["--uv", "0.4,0.9"][..], Place::point([0.4, 0.9])),
        (
            &["--uv", "0.4,0.9", "--footprint", "0.3"],
            Place { uv: [0.4, 0.9], footprint: Footprint::Isotropic(0.3) },
        ),
        (&["--uv", "0.4,-7", "--footprint", "0.2,0.1,-0.05,0.1"], Place { uv: [0.4, -7.0], footprint: axes }),
        (&["--footprint", "inf"], Place::far()),
    ];
    let mut seen = Vec::new();
    for (arguments, place) in places {
        let at = material.at(&place);
        let f = set.f(&[&["wood.safetensors"], arguments].concat());
        assert_eq!(f[..6], [at.eval(Vec3::Z, Vec3::Z), at.eval(LIGHT, VIEW)].map(|f| f.to_array()).concat());
        assert!(!seen.contains(&f), "{arguments:?}");
        seen.push(f);

        let sample = ["sample", "wood.safetensors", "--view", "0.6,0,0.8", "-n", "100", "-o", "s.npy"];
        set.0.succeeds(&[&sample[..], arguments].concat());
        let rows = Array::open(set.0.path("s.npy")).unwrap().values;
        for row in rows.chunks_exact(7).filter(|row| row[3] > 0.0) {
            assert_eq!(row[3], at.pdf(Vec3::from_slice(row), VIEW));
        }
    }
    // What is the same everywhere takes any place.
    assert_eq!(set.f(&["cloth.bin", "--uv", "0.3,0.2", "--footprint", "1"]), set.f(&["cloth.bin"]));
}

#[test]
fn a_surface_at_a_place_is_a_measurement_to_be() {
    let set = Set::new();
    let (library, _) = set.converted(&[]);
    set.0.succeeds(&["convert", "wood.safetensors", "wood.bin", "--uv", "0.4,0.9", "--footprint", "0.3"]);
    let place = Place { uv: [0.4, 0.9], footprint: Footprint::Isotropic(0.3) };
    let expected = library.material(None).unwrap().at(&place).eval(Vec3::Z, VIEW);
    let found =
        glimt_files::Source::open(set.0.path("wood.bin")).unwrap().brdf(None).unwrap().eval(Vec3::Z, VIEW);
    assert!((found - expected).abs().max_element() < 0.1 * expected.max_element(), "{found} {expected}");
    // Also right from the folder.
    set.0.succeeds(&["convert", "wood", "far.bin", "--footprint", "inf"]);
    let line = set.0.fails(1, &["convert", "wood.safetensors", "x.bin"]);
    assert!(line.contains("\"Wood\" is a surface") && line.contains("--uv"), "{line}");
    let line = set.0.fails(2, &["convert", "wood.safetensors", "x.safetensors", "--uv", "0,0"]);
    assert!(line.contains("do not apply to a library"), "{line}");
}

#[test]
fn without_a_place_a_surface_is_an_error_that_names_the_options() {
    let set = Set::new();
    set.converted(&[]);
    let eval = ["eval", "wood.safetensors", "--pairs", "pairs.npy", "-o", "f.npy"];
    let sample = ["sample", "wood.safetensors", "--view", "0,0,1", "-n", "9", "-o", "s.npy"];
    let check = ["check", "wood.safetensors", "--footprint", "0.1"];
    for command in [&eval[..], &sample, &[&eval[..], &["--footprint", "0.1"]].concat(), &check] {
        let line = set.0.fails(1, command);
        assert!(line.contains("\"Wood\" is a surface, another material at every place"), "{line}");
        assert!(line.contains("--uv U,V") && line.contains("--footprint inf"), "{line}");
    }
    let line = set.0.fails(1, &[&sample[..], &["--uv", "0,0", "--sampler", "lobes"]].concat());
    assert!(line.contains("leave out --sampler"), "{line}");
    for (option, value) in [("--uv", "0.3"), ("--uv", "nan,0"), ("--footprint", "-1"), ("--footprint", "1,2")]
    {
        let line = set.0.fails(2, &[&eval[..], &[option, value]].concat());
        assert!(line.contains(option) && line.contains(value), "{line}");
    }
}

#[test]
fn options_say_size_filter_and_wrap() {
    let set = Set::new();
    let (library, _) = set.converted(&["--size", "9", "--filter", "average", "--wrap", "clamp"]);
    let maps = maps_of(&library);
    assert_eq!((maps.size(), maps.wrap(), maps.filter()), ([4, 4], Wrap::Clamp, Filter::Average));
    let mean = maps.mean();
    let (reduced, said) = set.converted(&["--size", "2"]);
    assert!(said.contains("Wood_1K-PNG_Color.png is resized from 4 × 4 to 2 × 2"), "{said}");
    let small = maps_of(&reduced);
    assert_eq!(small.size(), [2, 2]);
    for (a, b) in [(mean.kd, small.mean().kd), (mean.f0, small.mean().f0)] {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.02), "{a:?} {b:?}");
    }
    // What normals vary within the new texels is roughness.
    assert!(small.mean().alpha > mean.alpha);
    let (plain, _) = set.converted(&["--size", "2", "--filter", "average"]);
    assert!((maps_of(&plain).mean().alpha - mean.alpha).abs() < 1e-6);
    let (coarse, _) = set.converted(&["--precision", "u8"]);
    let (fine, _) = set.converted(&[]);
    // A byte a number, and two numbers for the range of each channel.
    assert_eq!(coarse.tensor_bytes().unwrap().0, 4 * 4 * 9 + 2 * 4 * 9);
    let (coarse, fine) = (maps_of(&coarse).texel(1, 2), maps_of(&fine).texel(1, 2));
    assert!(coarse != fine && (coarse.kd[0] - fine.kd[0]).abs() < 0.01, "{coarse:?} {fine:?}");
    for option in [["--size", "2"], ["--filter", "average"], ["--wrap", "clamp"]] {
        let line = set.0.fails(2, &[&["convert", "lib.safetensors", "x.safetensors"], &option[..]].concat());
        assert!(line.contains(option[0]) && line.contains("folders of texture maps"), "{line}");
    }
}

#[test]
fn the_library_says_where_its_maps_come_from() {
    let set = Set::new();
    let (library, _) = set.converted(&["--size", "2"]);
    let bytes = std::fs::read(set.0.path("wood.safetensors")).unwrap();
    let origin = &library.entries().unwrap()[0].origin;
    assert_eq!((origin.source.as_str(), origin.command.as_str()), ("wood", "glimt convert --size 2"));
    assert_eq!(origin.version, env!("CARGO_PKG_VERSION"));
    let names: Vec<&str> = origin.files.iter().map(|file| file.name.as_str()).collect();
    let kinds = ["Color", "Metalness", "NormalGL", "Roughness"].map(|kind| format!("Wood_1K-PNG_{kind}.png"));
    assert_eq!(names, kinds);
    let lines = origin.files.iter().map(|file| format!("{}  {}\n", file.sha256, file.name));
    assert_eq!(origin.sha256, sha256_of(lines.collect::<String>().as_bytes()));
    assert_eq!(origin.files[0].sha256, sha256(&set.0.path(&format!("wood/{}", kinds[0]))).unwrap());
    // The same again, however the output is named, and of a material that is named.
    set.0.succeeds(&["convert", "wood", "again.safetensors", "--size", "2"]);
    assert!(bytes == std::fs::read(set.0.path("again.safetensors")).unwrap());
    let text = set.0.succeeds(&["info", "wood.safetensors"]);
    for part in [
        "form         2×2 texels, 2 levels by moments of slopes",
        "Wood  from wood (4 files)",
        "levels     2×2 1×1",
        "parts        maps 144 bytes",
        "stored     float32; 240 bytes in memory",
        "wrap       the maps repeat",
        "from afar  kd ",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json = set.0.succeeds(&["info", "--json", "wood.safetensors"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let surface = &json["materials"][0]["surface"];
    let mean = maps_of(&library).mean();
    assert_eq!(surface["far"]["kd"][0].as_f64().map(|kd| kd as f32), Some(mean.kd[0]));
    assert_eq!((&surface["wrap"], &surface["levels"][1][0]), (&"repeat".into(), &1.into()));
    assert_eq!((&json["tensor_bytes"]["maps"], &surface["precision"]), (&144.into(), &"f32".into()));
    assert_eq!(json["materials"][0]["files"][3]["name"], kinds[3]);
}

#[test]
fn several_folders_make_one_library_and_gltf_names_its_images() {
    let set = Set::new();
    let gltf = r#"{"asset": {"version": "2.0"}, "images": [{"uri": "base.png"}], "textures": [{"source": 0}],
        "materials": [{"name": "tiles", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}"#;
    std::fs::create_dir(set.0.path("scene")).unwrap();
    std::fs::write(set.0.path("scene/scene.gltf"), gltf).unwrap();
    std::fs::write(set.0.path("scene/scene.bin"), [0; 64]).unwrap();
    std::fs::write(set.0.path("scene/base.png"), png([4, 4], |x, _| [60 * x as u8; 3])).unwrap();
    set.0.succeeds(&["convert", "wood", "scene", "-o", "both.safetensors"]);
    let both = Library::open(set.0.path("both.safetensors")).unwrap();
    assert_eq!(both.names(), ["Wood", "tiles"]);
    let names = both.entry(Some("tiles")).unwrap().origin.files.iter().map(|file| file.name.clone());
    assert_eq!(names.collect::<Vec<_>>(), ["base.png", "scene.gltf"]);
    // Neither are libraries of two models one.
    let line = set.0.fails(1, &["convert", "both.safetensors", "lib.safetensors", "x.safetensors"]);
    assert!(line.contains("differ in model"), "{line}");
}

#[test]
fn precision_is_that_of_maps_in_a_library() {
    let set = Set::new();
    set.converted(&[]);
    set.0.succeeds(&["convert", "wood.safetensors", "small.safetensors", "--precision", "f16"]);
    let small = Library::open(set.0.path("small.safetensors")).unwrap();
    assert_eq!(small.tensor_bytes().unwrap().0, 4 * 4 * 9 * 2);
    let line = set.0.fails(2, &["convert", "lib.safetensors", "x.safetensors", "--precision", "u8"]);
    assert!(line.contains("a ggx material, but to maps"), "{line}");
    let line = set.0.fails(2, &["convert", "wood", "x.bin", "--precision", "u8", "--footprint", "inf"]);
    assert!(line.contains("--precision does not apply to .bin files"), "{line}");
}

/// One line that names the file and what is expected of it, and nothing written.
#[test]
fn maps_that_cannot_be_used() {
    let color = || png([4, 4], |_, _| [200, 100, 30]);
    let whole = color();
    let cases: [(&str, &str, Vec<u8>, &[&str]); 7] = [
        (
            "sizes",
            "Roughness",
            png([4, 3], |_, _| [90]),
            &["Roughness.png has 4 × 3", "expected maps of one shape"],
        ),
        (
            "grey normals",
            "NormalGL",
            png([4, 4], |x, _| [10 * x as u8; 3]),
            &["NormalGL.png holds no normals: all"],
        ),
        (
            "one channel",
            "NormalGL",
            png([4, 4], |_, _| [9]),
            &["NormalGL.png has one grey channel, expected three"],
        ),
        ("empty", "Color", Vec::new(), &["Color.png", "empty"]),
        ("truncated", "Color", whole[..whole.len() - 20].to_vec(), &["Color.png is not a"]),
        ("no image", "Metalness", b"GIF89a and more".to_vec(), &["Metalness.png", "expected"]),
        (
            "huge",
            "Color",
            png_that_claims(30_000),
            &["Color.png has 30000 × 30000 texels", "GiB, expected at most"],
        ),
    ];
    for (case, kind, bytes, parts) in cases {
        let set = Set::new();
        set.map(kind, &bytes);
        let line = set.0.fails(1, &["convert", "wood", "-o", "x.safetensors", "--size", "2"]);
        assert!(parts.iter().all(|part| line.contains(part)), "{case}: {line}");
    }
    let set = Set::new();
    std::fs::remove_file(set.0.path("wood/Wood_1K-PNG_Color.png")).unwrap();
    let line = set.0.fails(1, &["convert", "wood", "-o", "x.safetensors"]);
    assert!(line.contains("wood has no map of the colour: its images are"), "{line}");
    // It is the size that is too much, and not the image.
    let set = Set::new();
    set.map("Color", &png_that_claims(6000));
    let line = set.0.fails(1, &["convert", "wood", "-o", "x.safetensors"]);
    assert!(line.contains("--size N makes smaller maps"), "{line}");
    // An output is never an input.
    let map = "wood/Wood_1K-PNG_Roughness.png";
    let line = set.0.fails(1, &["convert", "wood", "--to", "library", "-o", map, "--force", "--size", "2"]);
    assert!(line.contains("must not be overwritten"), "{line}");
    let line = set.0.fails(1, &["info", "wood"]);
    assert!(line.contains("texture maps become one by glimt convert"), "{line}");
}

#[test]
fn a_surface_is_checked_at_several_places_or_at_one() {
    let set = Set::new();
    set.converted(&[]);
    let text = set.0.succeeds(&["check", "wood.safetensors", "--samples", "2000"]);
    assert_eq!(text.matches("\nWood at ").count() + usize::from(text.starts_with("Wood at ")), 5, "{text}");
    assert!(text.contains("\nWood from afar: pass"), "{text}");
    assert!(text.contains("A surface at 6 places; --uv and --footprint name another."), "{text}");
    let one = [
        "check",
        "wood.safetensors",
        "--samples",
        "2000",
        "--uv",
        "0.3,0.6",
        "--footprint",
        "0.05",
        "--json",
    ];
    let json: serde_json::Value = serde_json::from_str(&set.0.succeeds(&one)).unwrap();
    let names: Vec<&str> =
        json["subjects"].as_array().unwrap().iter().filter_map(|subject| subject["name"].as_str()).collect();
    assert_eq!(names, ["Wood at 0.3,0.6 footprint 0.05"]);
}

#[test]
fn a_surface_is_fitted_for_every_distance_and_stays_while_nothing_changes() {
    let set = Set::new();
    let fit = ["fit", "wood", "--model", "gated", "--steps", "20", "-o", "near.safetensors", "--if-changed"];
    let said = set.0.succeeds(&fit);
    assert!(said.contains("normals: Wood_1K-PNG_NormalGL.png"), "{said}");
    let heads = ["log-MAE at texels", "maps_average", "maps_moments", "gated", "mean"];
    assert!(heads.iter().all(|head| said.contains(head)), "{said}");
    let library = Library::open(set.0.path("near.safetensors")).unwrap();
    let entry = library.entry(None).unwrap();
    assert!(entry.material.is_surface());
    assert_eq!((entry.origin.steps, entry.origin.files.len()), (Some(20), 4));
    let levels = entry.origin.metrics.keys().filter(|key| key.starts_with("level_")).count();
    assert_eq!(levels, 3, "{:?}", entry.origin.metrics);
    assert!(set.0.succeeds(&fit).contains("is up to date"));

    // A library of the maps is the same surface.
    set.converted(&[]);
    set.0.succeeds(&[
        "fit",
        "wood.safetensors",
        "--model",
        "gated",
        "--steps",
        "20",
        "-o",
        "again.safetensors",
    ]);
    let at = ["--uv", "0.3,0.7", "--footprint", "0.2"];
    let near = set.f(&[&["near.safetensors"], &at[..]].concat());
    assert_eq!(near, set.f(&[&["again.safetensors"], &at[..]].concat()));
    assert!(near.iter().any(|&f| f > 0.0));
}

#[test]
fn fits_of_surfaces_say_what_they_cannot_do() {
    let set = Set::new();
    set.converted(&[]);
    let fit = |code, more: &[&str]| {
        let output = ["--model", "gated", "--steps", "1", "-o", "near.safetensors"];
        set.0.fails(code, &[&["fit"], more, &output[..]].concat())
    };
    for (code, arguments, reason) in [
        (2, &["wood", "wood.safetensors"][..], "--model gated fits one surface"),
        (2, &["wood.safetensors", "--size", "2"], "--size applies to folders of texture maps"),
        (1, &["wood", "--latent-size", "9"], "latent codes of 9 texels beside maps of 4, expected 1 to 4"),
        (2, &["wood", "--net", "24x2"], "expected 16, 32 or 64 times 2 or 3"),
        (2, &["wood", "--paper"], "--paper does not apply to --model gated"),
        (1, &["wood", "--resume"], "leave --resume out to start one"),
    ] {
        let said = fit(code, arguments);
        assert!(said.contains(reason), "{arguments:?}: {said}");
        assert!(!set.0.path("near.safetensors").exists());
    }
}
