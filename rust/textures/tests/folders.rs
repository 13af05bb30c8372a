//! Which files are taken, by their names.

mod common;

use std::fs;

use common::{exr, files, flat, floats, grey_jpeg, halves, jpeg, maps, open, png, refusal, said};
use glimt_textures::{Folder, MEMORY, Map, Size};

const FLAT: [u8; 3] = [128, 128, 255];

#[test]
fn a_folder_as_ambientcg_packs_it() {
    let list = [
        ("Wood049_1K-JPG_Color.jpg", jpeg([4, 4], [200, 100, 50], false)),
        ("Wood049_1K-JPG_NormalGL.jpg", flat([4, 4], [128, 192, 238])),
        ("Wood049_1K-JPG_NormalDX.jpg", flat([4, 4], [128, 64, 238])),
        ("Wood049_1K-JPG_Roughness.jpg", grey_jpeg([4, 4], 51)),
        ("Wood049_1K-JPG_AmbientOcclusion.jpg", Vec::new()),
        ("Wood049_1K-JPG_Displacement.jpg", Vec::new()),
        ("Wood049.png", flat([4, 4], [0; 3])),
        ("Wood049_1K-JPG.usdc", b"mesh".to_vec()),
        ("._Wood049_1K-JPG_Color.jpg", b"a fork of macOS".to_vec()),
    ];
    let folder = open(&list).unwrap();
    assert_eq!(folder.material(), "Wood049");
    assert_eq!(
        said(&folder),
        "colour: Wood049_1K-JPG_Color.jpg, 4 × 4 texels, 8 bits, JPEG, sRGB\n\
         roughness: Wood049_1K-JPG_Roughness.jpg, 4 × 4 texels, 8 bits, JPEG, linear\n\
         metalness: no map, 0 everywhere\n\
         normals: Wood049_1K-JPG_NormalGL.jpg, 4 × 4 texels, 8 bits, PNG, green points up (GL)\n\
         specular reflectance: no map, 0.04 everywhere\n\
         Wood049_1K-JPG_NormalDX.jpg is not used: Wood049_1K-JPG_NormalGL.jpg is taken for the normals\n\
         Wood049.png is not used: its name is that of no map\n\
         Wood049_1K-JPG_AmbientOcclusion.jpg is not used: ambient occlusion\n\
         Wood049_1K-JPG_Displacement.jpg is not used: heights\n"
    );
    let maps = folder.maps(Size::Own, MEMORY).unwrap();
    assert!((maps.roughness[0] - 0.2).abs() < 1e-6 && maps.metalness[0] == 0.0);
    assert!(maps.normal[0][1] > 0.4, "{:?}", maps.normal[0]);
    // ((200/255 + .055)/1.055)^2.4, within what JPEG rounds.
    assert!((maps.base_color[0][0] - 0.5776).abs() < 0.01, "{:?}", maps.base_color[0]);
}

#[test]
fn a_normal_map_of_directx_is_turned_up() {
    let color = ("m_diff_1k.png", flat([1, 1], [9; 3]));
    let normal = |name| maps(&[color.clone(), (name, flat([1, 1], [128, 64, 238]))]).normal[0];
    let (up, down, unsaid) = (normal("m_nor_gl_1k.png"), normal("m_nor_dx_1k.png"), normal("m_nor_1k.png"));
    assert_eq!([down[0], -down[1], down[2]], up);
    assert_eq!(unsaid, up);
    let folder = open(&[color, ("m_Normal.png", flat([1, 1], FLAT))]).unwrap();
    assert!(said(&folder).contains("green taken to point up (GL), which its name does not say"));
}

/// Waves as heights and as normals whose green channel points up.
fn waves(is_depth: bool) -> [(&'static str, Vec<u8>); 3] {
    let angle = |i: usize| std::f64::consts::TAU * i as f64 / 32.0;
    let height = png([32, 32], move |x, y| {
        let h = angle(x).sin() + angle(y).cos();
        [(127.5 + if is_depth { -50.0 } else { 50.0 } * h) as u8]
    });
    let normal = png([32, 32], move |x, y| {
        // y goes up, and rows down.
        let slope = [-0.5 * angle(x).cos(), -0.5 * angle(y).sin()];
        let length = (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
        [slope[0] / length, slope[1] / length, 1.0 / length].map(|n| (127.5 + 127.5 * n).round() as u8)
    });
    [("a_Color.png", flat([32, 32], [9; 3])), ("a_Normal.png", normal), ("a_Displacement.png", height)]
}

#[test]
fn heights_say_where_green_points_if_the_name_does_not() {
    let up = maps(&waves(false)).normal[0];
    let find = |list: &[(&str, Vec<u8>)]| {
        let maps = maps(list);
        (maps.normal[32 * 8][1], maps.findings.iter().map(ToString::to_string).collect::<String>())
    };
    let (y, text) = find(&waves(false));
    assert!(text.contains("a_Normal.png points up (GL), by the heights in a_Displacement.png"), "{text}");
    assert!(y < -0.4 && up[0] < -0.4, "{y} {up:?}");
    // Depths in place of heights turn both axes.
    assert_eq!(find(&waves(true)).0, y);
    // Mirrored images of green that points down.
    let mut down = waves(false);
    let [_, normal, _] = waves(false);
    down[1].1 = turned(&normal.1);
    let (y_down, text) = find(&down);
    assert!(text.contains("points down (DX) and is turned up, by the heights in"), "{text}");
    assert!((y_down - y).abs() < 0.01);
    // A name that says it needs no heights, and heights that are flat or broken say nothing.
    let mut named = down.clone();
    named[1].0 = "a_NormalGL.png";
    let (y_named, text) = find(&named);
    assert!(y_named > 0.4 && text.is_empty(), "{text}");
    let mut flat_heights = down.clone();
    flat_heights[2].1 = png([32, 32], |_, _| [7]);
    assert!(
        find(&flat_heights).1.contains("is taken to point up (GL): nothing is said by a_Displacement.png")
    );
    down[2].1.truncate(80);
    assert!(find(&down).0 > 0.4);
}

/// A PNG whose green channel is 255 minus what it was.
fn turned(bytes: &[u8]) -> Vec<u8> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut data).unwrap();
    png([32, 32], |x, y| {
        let texel = &data[3 * (32 * y + x)..][..3];
        [texel[0], 255 - texel[1], texel[2]]
    })
}

#[test]
fn a_folder_as_poly_haven_packs_it() {
    let n = 0.5 * (1.0 + 0.6);
    let normal = exr([1, 1], &[("R", halves(&[n])), ("G", halves(&[0.5])), ("B", halves(&[0.9]))]);
    let list = [
        ("rusty_metal_diff_1k.jpg", jpeg([8, 8], [128; 3], true)),
        ("rusty_metal_nor_gl_1k.exr", normal),
        ("rusty_metal_rough_1k.exr", exr([1, 1], &[("Y", floats(&[0.3]))])),
        ("rusty_metal_arm_1k.png", flat([8, 8], [255, 51, 204])),
        ("rusty_metal_spec_1k.png", png([8, 8], |_, _| [255])),
        ("rusty_metal.png", flat([2, 2], [0; 3])),
    ];
    let folder = open(&list).unwrap();
    assert_eq!(folder.material(), "rusty_metal");
    let text = said(&folder);
    // The separate map wins for the roughness; the packed one still says the metalness.
    assert!(
        text.contains("roughness: rusty_metal_rough_1k.exr, 1 × 1 texels, floats, OpenEXR, linear"),
        "{text}"
    );
    assert!(text.contains("metalness: rusty_metal_arm_1k.png, 8 × 8 texels, 8 bits, PNG, its blue channel"));
    assert!(text.contains("rusty_metal.png is not used: its material is \"rusty\" by its name"), "{text}");
    let maps = folder.maps(Size::Own, MEMORY).unwrap();
    assert_eq!(maps.roughness, [0.3; 64]);
    assert!((maps.metalness[63] - 0.8).abs() < 1e-6 && (maps.specular[0] - 0.08).abs() < 1e-7);
    assert!((maps.normal[0][0] - 0.6).abs() < 1e-3, "{:?}", maps.normal[0]);
    let packed = common::maps(&[list[0].clone(), list[3].clone()]);
    assert!((packed.roughness[0] - 0.2).abs() < 1e-6);
}

#[test]
fn a_folder_as_matsynth_packs_it() {
    let grey = |value| png([2, 2], move |_, _| [value]);
    let list = [
        ("basecolor.png", flat([2, 2], [255, 0, 0])),
        ("diffuse.png", flat([2, 2], [0; 3])),
        ("metallic.png", grey(255)),
        ("roughness.png", grey(0)),
        ("normal.png", flat([2, 2], FLAT)),
        ("specular.png", flat([2, 2], [255; 3])),
        ("height.png", grey(3)),
        ("opacity.png", grey(255)),
    ];
    let folder = open(&list).unwrap();
    assert_eq!(folder.material(), "wood", "the folder's name");
    let maps = folder.maps(Size::Own, MEMORY).unwrap();
    assert_eq!(maps.base_color[0], [1.0, 0.0, 0.0]);
    assert_eq!((maps.metalness[0], maps.roughness[0], maps.specular[0]), (1.0, 0.0, 0.04));
    assert!(said(&folder).contains("diffuse.png is not used: basecolor.png is taken for the colour"));
    // The heights say which way the normals point.
    assert_eq!(folder.files().len(), 5);
}

#[test]
fn a_gloss_map_is_turned_into_roughness() {
    let color = ("a_albedo.png", flat([1, 1], [9; 3]));
    let gloss = ("a_gloss.png", png([1, 1], |_, _| [51]));
    assert!((maps(&[color.clone(), gloss.clone()]).roughness[0] - 0.8).abs() < 1e-6);
    let folder = open(&[color, gloss, ("a_rough.png", png([1, 1], |_, _| [0]))]).unwrap();
    assert!(said(&folder).contains("a_gloss.png is not used: a_rough.png is taken for the roughness"));
}

#[test]
fn the_larger_and_the_more_exact_of_two_is_taken() {
    let list = [
        ("a_1K_Color.png", flat([2, 2], [1; 3])),
        ("a_2K_Color.jpg", jpeg([4, 4], [2; 3], false)),
        ("a_2K_Color.png", flat([4, 4], [3; 3])),
        ("a_1K_Roughness.png", png([2, 2], |_, _| [255])),
    ];
    let folder = open(&list).unwrap();
    let text = said(&folder);
    assert!(text.contains("colour: a_2K_Color.png, 4 × 4"), "{text}");
    assert!(text.contains("a_1K_Color.png is not used: a_2K_Color.png is taken for the colour"));
    let maps = folder.maps(Size::Own, MEMORY).unwrap();
    assert_eq!((maps.size, maps.roughness.len()), ([4, 4], 16));
    let resized: Vec<String> = maps.findings.iter().map(ToString::to_string).collect();
    assert_eq!(resized, ["roughness: a_1K_Roughness.png is resized from 2 × 2 to 4 × 4"]);
}

#[test]
fn several_materials_are_told_apart_by_their_names() {
    let folder = tempfile::tempdir().unwrap();
    for (file, bytes) in files(&[
        ("Wood047_Color.png", flat([1, 1], [1; 3])),
        ("MetalPlates006_Color.png", flat([1, 1], [2; 3])),
        ("MetalPlates006_Metalness.png", png([1, 1], |_, _| [255])),
    ]) {
        fs::write(folder.path().join(file), bytes).unwrap();
    }
    let message = Folder::open(&folder).unwrap_err().to_string();
    assert!(
        message.ends_with("has 2 materials, name one of them: \"MetalPlates006\", \"Wood047\""),
        "{message}"
    );
    let wood = Folder::open_material(&folder, "wood047").unwrap();
    assert_eq!(wood.material(), "Wood047");
    let text = said(&wood);
    assert!(text.contains("metalness: no map, 0 everywhere"));
    assert!(!text.contains("MetalPlates006"), "other materials are none of its business: {text}");
    let message = Folder::open_material(&folder, "Wood").unwrap_err().to_string();
    assert!(message.contains("no material \"Wood\", only \"MetalPlates006\", \"Wood047\""), "{message}");
}

#[test]
fn one_image_is_the_colour_alone() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["planks.png", "planks_diff_1k.png", "planks_rough_1k.png"] {
        fs::write(folder.path().join(name), flat([3, 2], [255; 3])).unwrap();
    }
    for name in ["planks.png", "planks_diff_1k.png"] {
        let image = Folder::open(folder.path().join(name)).unwrap();
        assert_eq!(image.material(), "planks");
        assert_eq!(image.findings().len(), 5);
        let maps = image.maps(Size::Own, MEMORY).unwrap();
        assert_eq!((maps.size, maps.base_color[5], maps.roughness[5]), ([3, 2], [1.0; 3], 0.5));
    }
    let message = Folder::open(folder.path().join("planks_rough_1k.png")).unwrap_err().to_string();
    assert!(message.contains("is a map of roughness by its name, expected one of the colour"), "{message}");
}

#[test]
fn a_subfolder_of_textures_is_looked_into() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("Textures")).unwrap();
    fs::write(folder.path().join("planks_1k.blend"), b"").unwrap();
    fs::write(folder.path().join("Textures/planks_diff_1k.png"), flat([1, 1], [1; 3])).unwrap();
    assert_eq!(Folder::open(&folder).unwrap().material(), "planks");
}

#[test]
fn folders_without_a_colour_map_are_refused_with_what_they_have() {
    let rough = png([1, 1], |_, _| [9]);
    assert!(refusal(&[]).starts_with("wood has no map of the colour: it has no images; expected"));
    let message =
        refusal(&[("a_rough.png", rough.clone()), ("a_diff.tif", Vec::new()), ("notes.txt", Vec::new())]);
    assert!(
        message.contains("its images are \"a_diff.tif\", \"a_rough.png\", not all of a format that is read"),
        "{message}"
    );
    let many: Vec<_> = (0..9).map(|i| (format!("{i}23.png"), rough.clone())).collect();
    let message = Folder::from_files("wood", many).unwrap_err().to_string();
    assert!(message.contains("\"523.png\" and 3 more;"), "{message}");
    let message = Folder::open("/no/such/folder").unwrap_err().to_string();
    assert!(message.starts_with("cannot read /no/such/folder: "), "{message}");
}

/// A material with everything.
fn helmet() -> serde_json::Value {
    serde_json::json!({
        "asset": {"version": "2.0"},
        "materials": [{
            "name": "Helmet",
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": 0},
                "baseColorFactor": [0.5, 1.0, 0.25, 1.0],
                "metallicRoughnessTexture": {"index": 1},
                "roughnessFactor": 0.5
            },
            "normalTexture": {"index": 2, "scale": 0.5},
            "extensions": {
                "KHR_materials_ior": {"ior": 2.0},
                "KHR_materials_specular": {"specularFactor": 0.5}
            }
        }],
        "textures": [{"source": 1}, {"source": 0}, {"source": 2}],
        "images": [{"uri": "metal%20rough.png"}, {"uri": "maps/color.png"}, {"uri": "n.png"}]
    })
}

fn helmet_images() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("metal rough.png", flat([1, 1], [0, 102, 255])),
        ("maps/color.png", flat([2, 1], [255; 3])),
        ("n.png", flat([1, 1], [218, 128, 218])),
    ]
}

fn check_helmet(folder: &Folder) {
    assert_eq!(folder.material(), "Helmet");
    let maps = folder.maps(Size::Own, MEMORY).unwrap();
    assert_eq!((maps.size, maps.base_color[0]), ([2, 1], [0.5, 1.0, 0.25]));
    assert!((maps.roughness[0] - 0.2).abs() < 1e-6 && maps.metalness[0] == 1.0);
    // The slope 1 of 45° becomes 0.5; F0 of the index 2 is 1/9.
    assert!((maps.normal[0][0] / maps.normal[0][2] - 0.5).abs() < 1e-3);
    assert!((maps.specular[0] - 0.5 / 9.0).abs() < 1e-7);
}

#[test]
fn a_gltf_file_names_its_images() {
    let mut list = helmet_images();
    list.push(("Helmet.gltf", helmet().to_string().into_bytes()));
    let folder = open(&list).unwrap();
    check_helmet(&folder);
    let text = said(&folder);
    assert!(
        text.contains("roughness: metal rough.png, 1 × 1 texels, 8 bits, PNG, its green channel, times 0.5"),
        "{text}"
    );

    let disk = tempfile::tempdir().unwrap();
    fs::create_dir(disk.path().join("maps")).unwrap();
    for (name, bytes) in files(&list) {
        fs::write(disk.path().join(name), bytes).unwrap();
    }
    check_helmet(&Folder::open(disk.path().join("Helmet.gltf")).unwrap());
}

/// A `.glb` file of a document and its binary chunk.
fn glb(document: &serde_json::Value, mut binary: Vec<u8>) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut file = b"glTF".to_vec();
    for number in [2, 28 + json.len() + binary.len(), json.len()] {
        file.extend((number as u32).to_le_bytes());
    }
    file.extend(b"JSON");
    file.extend(json);
    file.extend((binary.len() as u32).to_le_bytes());
    file.extend(b"BIN\0");
    file.extend(binary);
    file
}

#[test]
fn a_glb_file_holds_its_images() {
    let mut document = helmet();
    let mut binary = Vec::new();
    let (mut views, mut images) = (Vec::new(), Vec::new());
    for (i, (_, bytes)) in helmet_images().into_iter().enumerate() {
        views.push(serde_json::json!({"buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len()}));
        images.push(serde_json::json!({"bufferView": i, "mimeType": "image/png"}));
        binary.extend(bytes);
    }
    document["bufferViews"] = views.into();
    document["images"] = images.into();
    document["buffers"] = serde_json::json!([{"byteLength": binary.len()}]);
    let file = glb(&document, binary);
    check_helmet(&open(&[("helmet.glb", file.clone())]).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("helmet.glb");
    fs::write(&path, &file).unwrap();
    check_helmet(&Folder::open(&path).unwrap());
    for length in 0..file.len() - 4 {
        assert!(!refusal(&[("helmet.glb", file[..length].to_vec())]).is_empty());
    }
}

#[test]
fn an_image_in_the_name_of_a_gltf_image_is_read() {
    use base64::Engine;
    let data = base64::prelude::BASE64_STANDARD.encode(flat([1, 1], [255; 3]));
    let document = |uri: &str| {
        let document = serde_json::json!({
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
            "textures": [{"source": 0}], "images": [{"uri": uri}]
        });
        ("a.gltf", document.to_string().into_bytes())
    };
    let folder = open(&[document(&format!("data:image/png;base64,{data}"))]).unwrap();
    let maps = folder.maps(Size::Own, MEMORY).unwrap();
    // What glTF says where nothing is said.
    assert_eq!((folder.material(), maps.roughness[0], maps.metalness[0]), ("0", 1.0, 1.0));
    assert!(refusal(&[document("data:image/png;base64,§")]).contains("is not base64"));
    assert!(refusal(&[document("https://example.org/a.png")]).contains("expected a file"));
    assert!(refusal(&[document("none.png")]).starts_with("cannot read wood/none.png: "));
}

#[test]
fn broken_gltf_files_are_refused() {
    type Change = fn(&mut serde_json::Value);
    let with = |change: Change| {
        let mut document = helmet();
        change(&mut document);
        let mut list = helmet_images();
        list.push(("Helmet.gltf", document.to_string().into_bytes()));
        refusal(&list)
    };
    let cases: [(Change, &str); 6] = [
        (|d| d["materials"] = serde_json::json!([]), "it has no materials"),
        (
            |d| d["materials"][0] = serde_json::json!({"name": "plain"}),
            "its material \"plain\" has no textures",
        ),
        (|d| d["textures"] = serde_json::json!([]), "it has 0 of what it calls texture 0"),
        (|d| d["textures"][0] = serde_json::json!({}), "its texture 0 has no PNG or JPEG image"),
        (|d| d["images"][1] = serde_json::json!({}), "its image 1 is nowhere"),
        (
            |d| d["images"][1] = serde_json::json!({"bufferView": 3}),
            "it has 0 of what it calls buffer view 3",
        ),
    ];
    for (change, expected) in cases {
        let message = with(change);
        assert!(message.starts_with("wood/Helmet.gltf is not a glTF file: "), "{message}");
        assert!(message.contains(expected), "{message}");
    }
    let several = with(|d| d["materials"].as_array_mut().unwrap().push(serde_json::json!({})));
    assert_eq!(several, "wood/Helmet.gltf has 2 materials, name one of them: \"Helmet\", \"1\"");
    assert!(refusal(&[("a.gltf", b"{".to_vec())]).contains("is not a glTF file: EOF"));
}

#[test]
fn images_that_are_known_by_their_names_go_before_a_gltf_file() {
    let folder = open(&[("a_Color.png", flat([1, 1], [1; 3])), ("a.gltf", b"{".to_vec())]).unwrap();
    assert!(said(&folder).contains("a.gltf is not used: the images are known by their names"));
}

#[test]
fn findings_can_be_told_to_programs() {
    let folder = open(&[("a_Color.png", flat([1, 1], [1; 3]))]).unwrap();
    let json = serde_json::to_value(folder.findings()).unwrap();
    assert_eq!(json[0]["kind"], "taken");
    assert_eq!(json[1]["map"], serde_json::to_value(Map::Roughness).unwrap());
}
