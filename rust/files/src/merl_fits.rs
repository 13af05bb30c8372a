//! Published analytic fits to the MERL materials, in the text form in which the BSDF library BBM collects
//! them (`.fit`): a line a material,
//!
//! `name = Aggregate(Lambertian(albedo = [r, g, b]), Lobe(parameter = value, ...))`.

use std::path::Path;

use glimt_core::analytic::{Analytic, Parameters, Rgb, Specular};
use glimt_core::library::{Entry, Origin};
use glimt_core::{Library, Material};
use glimt_measured::file::read_regular;

use crate::error::Error;
use crate::source::{file_name, sha256};

/// The lobes that are read.
const LOBES: [&str; 5] =
    ["NganCookTorrance", "NganWard", "NganAshikhminShirley", "LowMicrofacetFit", "Bagher"];
const FORMAT: &str = "a file of analytic fits";
/// Largest file that is read; the published ones have 48 kB.
const MAX_BYTES: u64 = 1 << 22;

/// The materials of a file as a library of kind `analytic`.
///
/// # Errors
/// [`Error::Read`], or [`Error::Format`] with the line, what was found and what was expected.
pub fn open(path: &Path) -> Result<Library, Error> {
    let invalid = |reason| Error::Format { path: path.to_owned(), format: FORMAT, reason };
    let size = std::fs::metadata(path).map_err(Error::read(path))?.len();
    if size > MAX_BYTES {
        return Err(invalid(format!("it has {size} bytes, expected at most {MAX_BYTES}")));
    }
    let bytes = read_regular(path).map_err(Error::read(path))?;
    let origin = Origin {
        source: file_name(path),
        sha256: sha256(path)?,
        command: "import".into(),
        license: "3-clause BSD (the collection); parameters as published".into(),
        ..Origin::default()
    };
    let entries = materials(&bytes).map_err(invalid)?.into_iter().map(|(name, material)| Entry {
        name,
        material: Material::Analytic(material),
        origin: origin.clone(),
    });
    Ok(Library::new(path, entries.collect())?)
}

/// The materials that the bytes of a file hold, by name.
///
/// # Errors
/// In words, the line, what was found and what was expected.
pub fn materials(bytes: &[u8]) -> Result<Vec<(String, Analytic)>, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "it is not text")?;
    text.lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'))
        .map(|(number, line)| parse(line).map_err(|e| format!("line {}: {e}", number + 1)))
        .collect()
}

fn parse(line: &str) -> Result<(String, Analytic), String> {
    let (name, rest) = line.split_once(" = ").ok_or("expected \"name = Aggregate(...)\"")?;
    let inner = call(rest.trim(), "Aggregate")?;
    let (diffuse, specular) = inner
        .split_once("), ")
        .ok_or("expected a Lambertian and a specular lobe, with a comma between them")?;
    let diffuse = Arguments::new(call(&format!("{diffuse})"), "Lambertian")?)?.rgb("albedo")?;
    let (lobe, _) = specular.split_once('(').ok_or("expected a specular lobe")?;
    let arguments = Arguments::new(call(specular, lobe)?)?;
    let specular = match lobe {
        "NganCookTorrance" => Specular::CookTorrance {
            scale: arguments.rgb("albedo")?,
            reflectance: arguments.number("eta")?,
            roughness: arguments.number("roughness")?,
        },
        "NganWard" => {
            Specular::Ward { scale: arguments.rgb("albedo")?, roughness: arguments.number("roughness")? }
        }
        "NganAshikhminShirley" => Specular::AshikhminShirley {
            scale: arguments.rgb("albedo")?,
            reflectance: arguments.number("fresnelReflectance")?,
            sharpness: arguments.number("sharpness")?,
        },
        "LowMicrofacetFit" => Specular::LowMicrofacet {
            scale: arguments.rgb("A")?,
            slope: arguments.number("B")?,
            falloff: arguments.number("C")?,
            eta: arguments.number("eta")?,
        },
        "Bagher" => Specular::ShiftedGamma {
            scale: arguments.rgb("albedo")?,
            alpha: arguments.rgb("alpha")?,
            power: arguments.rgb("p")?,
            fresnel: arguments.rows("eta")?,
            norm: arguments.rgb("K")?,
            masking: [
                arguments.rgb("Lambda")?,
                arguments.rgb("c")?,
                arguments.rgb("k")?,
                arguments.rgb("theta0")?,
            ],
        },
        other => return Err(format!("the lobe is {other}, expected {}", LOBES.join(", "))),
    };
    Ok((name.trim().to_owned(), Analytic::new(Parameters { diffuse, specular })?))
}

/// What stands between the parentheses of `name(...)`.
fn call<'a>(text: &'a str, name: &str) -> Result<&'a str, String> {
    text.trim()
        .strip_prefix(name)
        .and_then(|rest| rest.strip_prefix('('))
        .and_then(|rest| rest.strip_suffix(')'))
        .ok_or_else(|| format!("expected {name}(...)"))
}

/// `name = value` pairs, as JSON knows the values.
struct Arguments(Vec<(String, serde_json::Value)>);

impl Arguments {
    fn new(text: &str) -> Result<Arguments, String> {
        let mut arguments = Vec::new();
        let mut rest = text;
        while let Some((name, after)) = rest.split_once('=') {
            // A value ends at a comma outside of all brackets.
            let mut depth = 0;
            let end = after.find(|letter| {
                depth += i32::from(letter == '[') - i32::from(letter == ']');
                depth == 0 && letter == ','
            });
            let (value, next) = end.map_or((after, ""), |end| (&after[..end], &after[end + 1..]));
            let name = name.trim().to_owned();
            let value = serde_json::from_str(value.trim()).map_err(|e| format!("{name}: {e}"))?;
            arguments.push((name, value));
            rest = next;
        }
        Ok(Arguments(arguments))
    }

    fn take<T: serde::de::DeserializeOwned>(&self, name: &str, expected: &str) -> Result<T, String> {
        let (_, value) =
            self.0.iter().find(|(other, _)| other == name).ok_or_else(|| format!("{name} is missing"))?;
        serde_json::from_value(value.clone()).map_err(|_| format!("{name} is {value}, expected {expected}"))
    }

    fn number(&self, name: &str) -> Result<f64, String> {
        self.take(name, "a number")
    }

    fn rgb(&self, name: &str) -> Result<Rgb, String> {
        self.take(name, "three numbers")
    }

    fn rows(&self, name: &str) -> Result<[Rgb; 2], String> {
        self.take(name, "two rows of three numbers")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WARD: &str = "paint = Aggregate(Lambertian(albedo = [0.1, 0.2, 0.3]), NganWard(albedo = [1e-2, 0, 0.5], roughness = 0.02))";

    #[test]
    fn a_line_is_a_material() {
        let (name, material) = parse(WARD).unwrap();
        assert_eq!(name, "paint");
        // Parameters are float32, as the library stores them.
        let specular =
            Specular::Ward { scale: [0.01_f32, 0.0, 0.5].map(f64::from), roughness: 0.02_f32.into() };
        let diffuse = [0.1_f32, 0.2, 0.3].map(f64::from);
        assert_eq!(*material.parameters(), Parameters { diffuse, specular });
    }

    #[test]
    fn what_is_broken_is_named() {
        let refused = |from: &str, to: &str| parse(&WARD.replace(from, to)).unwrap_err();
        assert!(refused("NganWard", "NganHe").contains("the lobe is NganHe, expected NganCookTorrance"));
        assert!(refused("roughness", "rough").contains("roughness is missing"));
        assert!(refused("0.02", "[0.02]").contains("roughness is [0.02], expected a number"));
        assert!(refused("0.02", "0.02.1").contains("roughness: "));
        assert!(refused("0.2,", "").contains("albedo is"));
        assert!(refused("0.02", "0.0").contains("roughness is 0, expected a number that is positive"));
        assert!(refused("Aggregate", "Sum").contains("expected Aggregate(...)"));
        assert!(parse("paint").unwrap_err().contains("name = Aggregate"));
    }
}
