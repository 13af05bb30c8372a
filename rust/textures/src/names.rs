//! What the names of files say: ambientCG's, Poly Haven's, MatSynth's, those of glTF's exporters, and variations.
//!
//! A name is split into words where letters meet other signs, and where a capital follows a small letter. What the
//! map is of is said by the last words, so that the material may have any name: `rough_wood_diff_1k` is a map of
//! colour, and `roughwood` is no map. Resolutions, formats and numbers after these words are passed over.

/// Which way the green channel of a normal map points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Green {
    /// Up in the image, as OpenGL has it.
    Up,
    /// Down in the image, as DirectX has it.
    Down,
    /// The name does not say.
    Unsaid,
}

/// What a map is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    BaseColor,
    /// What Poly Haven calls its base colour, and what is black for metals elsewhere.
    Diffuse,
    Roughness,
    /// 1 − roughness.
    Gloss,
    Metalness,
    Normal(Green),
    /// Roughness in the green channel and metalness in the blue one.
    Packed,
    /// Reflectance at normal incidence, 0.08 where it is white.
    SpecularLevel,
    /// Heights. No parameter comes from them, but they say which way normals point.
    Height,
    /// What no parameter comes from, in words.
    Unused(&'static str),
}

impl Role {
    /// What the map is of, in words.
    pub(crate) fn of(self) -> &'static str {
        match self {
            Role::BaseColor | Role::Diffuse => "colour",
            Role::Roughness => "roughness",
            Role::Gloss => "gloss",
            Role::Metalness => "metalness",
            Role::Normal(_) => "normals",
            Role::Packed => "roughness and metalness",
            Role::SpecularLevel => "specular level",
            Role::Height => "heights",
            Role::Unused(what) => what,
        }
    }
}

/// What a file's name says.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Name {
    /// The material, as it is written; empty where the name is that of the map alone.
    pub(crate) material: String,
    pub(crate) role: Role,
}

/// What the last words are, with `_` where there is a sign between them.
///
/// `metalrough` is packed, but `metal_rough` is the roughness of a metal: Poly Haven's `rusty_metal_rough_1k`. So is
/// `RustyMetalRough`: these two names have to follow a sign.
const ROLES: &[(&str, Role)] = &[
    ("basecolor", Role::BaseColor),
    ("basecolour", Role::BaseColor),
    ("base_color", Role::BaseColor),
    ("base_colour", Role::BaseColor),
    ("color", Role::BaseColor),
    ("colour", Role::BaseColor),
    ("col", Role::BaseColor),
    ("albedo", Role::BaseColor),
    ("diffuse", Role::Diffuse),
    ("diff", Role::Diffuse),
    ("roughness", Role::Roughness),
    ("rough", Role::Roughness),
    ("gloss", Role::Gloss),
    ("glossiness", Role::Gloss),
    ("smoothness", Role::Gloss),
    ("metalness", Role::Metalness),
    ("metallic", Role::Metalness),
    ("metal", Role::Metalness),
    ("normal", Role::Normal(Green::Unsaid)),
    ("normals", Role::Normal(Green::Unsaid)),
    ("nor", Role::Normal(Green::Unsaid)),
    ("norm", Role::Normal(Green::Unsaid)),
    ("nrm", Role::Normal(Green::Unsaid)),
    ("normalgl", Role::Normal(Green::Up)),
    ("normal_gl", Role::Normal(Green::Up)),
    ("normal_ogl", Role::Normal(Green::Up)),
    ("normalopengl", Role::Normal(Green::Up)),
    ("normal_opengl", Role::Normal(Green::Up)),
    ("nor_gl", Role::Normal(Green::Up)),
    ("normaldx", Role::Normal(Green::Down)),
    ("normal_dx", Role::Normal(Green::Down)),
    ("normaldirectx", Role::Normal(Green::Down)),
    ("normal_directx", Role::Normal(Green::Down)),
    ("nor_dx", Role::Normal(Green::Down)),
    ("arm", Role::Packed),
    ("orm", Role::Packed),
    ("metalrough", Role::Packed),
    ("metalroughness", Role::Packed),
    ("metallicroughness", Role::Packed),
    ("metallic_roughness", Role::Packed),
    ("occlusionroughnessmetallic", Role::Packed),
    ("occlusion_roughness_metallic", Role::Packed),
    ("spec", Role::SpecularLevel),
    ("specularlevel", Role::SpecularLevel),
    ("specular_level", Role::SpecularLevel),
    ("specular", Role::Unused("a colour at normal incidence, which base colour and metalness say")),
    ("displacement", Role::Height),
    ("disp", Role::Height),
    ("height", Role::Height),
    ("bump", Role::Height),
    ("depth", Role::Height),
    ("ambientocclusion", Role::Unused("ambient occlusion")),
    ("ambient_occlusion", Role::Unused("ambient occlusion")),
    ("occlusion", Role::Unused("ambient occlusion")),
    ("ao", Role::Unused("ambient occlusion")),
    ("opacity", Role::Unused("opacity")),
    ("alpha", Role::Unused("opacity")),
    ("mask", Role::Unused("a mask")),
    ("translucent", Role::Unused("translucency")),
    ("translucency", Role::Unused("translucency")),
    ("emission", Role::Unused("emission")),
    ("emissive", Role::Unused("emission")),
    ("anisotropy", Role::Unused("anisotropy")),
];

/// What a name without its extension says; `None` if it names no map.
pub(crate) fn parse(stem: &str) -> Option<Name> {
    let mut words = words(stem);
    while words.last().is_some_and(|word| is_variant(&word.text) || is_number(&word.text)) {
        words.pop();
    }
    let (first, role) = (0..words.len()).find_map(|first| Some((first, role_of(&words[first..])?)))?;
    words.truncate(first);
    while words.last().is_some_and(|word| is_variant(&word.text)) {
        words.pop();
    }
    let material = words.last().map_or("", |word| &stem[..word.end]);
    Some(Name { material: material.to_owned(), role })
}

fn role_of(words: &[Word]) -> Option<Role> {
    // No name of a role has more words.
    const MOST: usize = 3;
    if words.len() > MOST {
        return None;
    }
    let mut text = String::new();
    for (i, word) in words.iter().enumerate() {
        if i > 0 && word.is_apart {
            text.push('_');
        }
        text.push_str(&word.text);
    }
    if text.starts_with("metalrough") && !words[0].is_apart {
        return None;
    }
    ROLES.iter().find(|(name, _)| *name == text).map(|(_, role)| *role)
}

/// Resolutions, formats and empty words such as "map".
fn is_variant(word: &str) -> bool {
    let is_resolution = word
        .strip_suffix('k')
        .or(word.strip_suffix("bit"))
        .is_some_and(|number| (1..=2).contains(&number.len()) && is_number(number));
    is_resolution
        || matches!(word, "256" | "512" | "1024" | "2048" | "4096" | "8192" | "16384")
        || matches!(word, "jpg" | "jpeg" | "png" | "exr" | "map" | "tex" | "texture")
}

/// The number of a variant: Poly Haven's `col_01`.
fn is_number(word: &str) -> bool {
    word.len() <= 2 && word.bytes().all(|byte| byte.is_ascii_digit())
}

/// A word of a name.
struct Word {
    /// In small letters.
    text: String,
    /// Where it ends in the name.
    end: usize,
    /// Whether there is a sign between it and the word before.
    is_apart: bool,
}

fn words(stem: &str) -> Vec<Word> {
    let mut words: Vec<Word> = Vec::new();
    let mut before = None;
    let mut signs = stem.char_indices().peekable();
    while let Some((at, sign)) = signs.next() {
        if sign.is_alphanumeric() {
            let next = signs.peek().map(|&(_, next)| next);
            if before.is_none_or(|before| is_start(before, sign, next)) {
                words.push(Word { text: String::new(), end: 0, is_apart: before.is_none() });
            }
            if let Some(word) = words.last_mut() {
                word.text.extend(sign.to_lowercase());
                word.end = at + sign.len_utf8();
            }
        }
        before = Some(sign).filter(|sign| sign.is_alphanumeric());
    }
    words
}

/// Whether a word starts at `sign`: `base|Color`, `GL|Normal`, `006|Color`, but `1K`.
fn is_start(before: char, sign: char, next: Option<char>) -> bool {
    sign.is_uppercase() && (before.is_lowercase() || next.is_some_and(char::is_lowercase))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(stem: &str) -> (String, Role) {
        let name = parse(stem).unwrap_or_else(|| panic!("{stem} is no map"));
        (name.material, name.role)
    }

    #[test]
    fn names_of_the_sources_are_known() {
        let cases = [
            ("Wood049_1K-JPG_Color", "Wood049", Role::BaseColor),
            ("Wood049_1K-JPG_NormalGL", "Wood049", Role::Normal(Green::Up)),
            ("Wood049_1K-JPG_NormalDX", "Wood049", Role::Normal(Green::Down)),
            ("Wood049_1K-JPG_Roughness", "Wood049", Role::Roughness),
            ("Metal012_2K-PNG_Metalness", "Metal012", Role::Metalness),
            ("Wood049_1K-JPG_AmbientOcclusion", "Wood049", Role::Unused("ambient occlusion")),
            ("Wood049_1K-JPG_Displacement", "Wood049", Role::Height),
            ("MetalPlates006_Normal", "MetalPlates006", Role::Normal(Green::Unsaid)),
            ("brown_planks_05_diff_1k", "brown_planks_05", Role::Diffuse),
            ("brown_planks_05_nor_gl_4k", "brown_planks_05", Role::Normal(Green::Up)),
            ("brown_planks_05_nor_dx_4k", "brown_planks_05", Role::Normal(Green::Down)),
            ("brown_planks_05_rough_1k", "brown_planks_05", Role::Roughness),
            ("rusty_metal_02_metal_1k", "rusty_metal_02", Role::Metalness),
            ("rusty_metal_rough_1k", "rusty_metal", Role::Roughness),
            ("brown_planks_05_arm_2k", "brown_planks_05", Role::Packed),
            ("brown_planks_05_spec_1k", "brown_planks_05", Role::SpecularLevel),
            ("fabric_pattern_05_col_01_4k", "fabric_pattern_05", Role::BaseColor),
            ("basecolor", "", Role::BaseColor),
            ("diffuse", "", Role::Diffuse),
            ("metallic", "", Role::Metalness),
            ("height", "", Role::Height),
            ("Default_albedo", "Default", Role::BaseColor),
            ("Default_metalRoughness", "Default", Role::Packed),
            ("RustyMetalRoughness", "RustyMetal", Role::Roughness),
            ("Default_metallicRoughness", "Default", Role::Packed),
            ("Helmet_MetalRough", "Helmet", Role::Packed),
            ("Crate_OcclusionRoughnessMetallic", "Crate", Role::Packed),
            ("Crate_ORM", "Crate", Role::Packed),
            ("WoodBaseColor", "Wood", Role::BaseColor),
            ("wood base-colour map 2048", "wood", Role::BaseColor),
            ("Wood047_Rough_8bit", "Wood047", Role::Roughness),
            ("Rinde_Gloss", "Rinde", Role::Gloss),
            ("höhe_Color", "höhe", Role::BaseColor),
        ];
        for (stem, material, role) in cases {
            assert_eq!(parsed(stem), (material.to_owned(), role), "{stem}");
        }
    }

    #[test]
    fn what_only_contains_a_word_is_no_map() {
        for stem in [
            "roughwood",
            "Wood049",
            "colorful_tiles",
            "normalised",
            "metal_plates",
            "",
            "_",
            "4k",
            "rough_wood",
        ] {
            assert_eq!(parse(stem), None, "{stem}");
        }
    }

    #[test]
    fn the_material_may_be_called_as_a_map_is() {
        assert_eq!(parsed("rough_metal_color"), ("rough_metal".into(), Role::BaseColor));
        assert_eq!(parsed("Color_Color"), ("Color".into(), Role::BaseColor));
        assert_eq!(parsed("PaintedMetal004_1K_Color"), ("PaintedMetal004".into(), Role::BaseColor));
    }

    proptest::proptest! {
        #[test]
        fn any_name_before_a_role_is_the_material(material in "[a-z]{1,8}([ _-][a-zé]{1,8}){0,3}[0-9]{3}") {
            for (name, role) in ROLES {
                proptest::prop_assert_eq!(parsed(&format!("{material}_{name}_2K")), (material.clone(), *role));
            }
        }

        #[test]
        fn no_name_is_too_odd(stem in ".*") {
            parse(&stem);
        }
    }
}
