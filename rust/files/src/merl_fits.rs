//! Published analytic fits to the MERL materials, in the text form in which the BSDF library BBM collects
//! them (`.fit`): a line a material,
//!
//! `name = Aggregate(Lambertian(albedo = [r, g, b]), Lobe(parameter = value, ...))`.

use std::path::Path;

use glimt_core::library::{Entry, Origin};
use glimt_core::models::analytic::{Analytic, Parameters, Rgb, Specular};
use glimt_core::{Library, Material};
use glimt_measured::file::read_regular;

use crate::error::Error;
use crate::source::{file_name, sha256};

/// The lobes that are read.
const LOBES: [&str; 5] =
    ["NganCookTorrance", "NganWard", "NganAshikhminShirley", "LowMicrofacetFit", "Bagher"];
const FORMAT: &str = "a file of analytic fits";
/// What red, green and blue of the database are multiplied by besides 1/1500. The fits of Ngan et al. 2005 were made
/// without: their albedos of white acrylic are 0.313, 0.258, 0.155 where Löw et al. 2012 have 0.317, 0.301, 0.263.
const MERL_CHANNELS: Rgb = [1.0, 1.15, 1.66];
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
        material: Material::from(material),
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
    let (lobe, _) = specular.split_once('(').ok_or("expected a specular lobe")?;
    let channels = if lobe.trim().starts_with("Ngan") { MERL_CHANNELS } else { [1.0; 3] };
    let albedo = |arguments: &Arguments| Ok::<Rgb, String>(times(arguments.rgb("albedo")?, channels));
    let diffuse = albedo(&Arguments::new(call(&format!("{diffuse})"), "Lambertian")?)?)?;
    let arguments = Arguments::new(call(specular, lobe)?)?;
    let specular = match lobe {
        "NganCookTorrance" => Specular::CookTorrance {
            scale: albedo(&arguments)?,
            reflectance: arguments.number("eta")?,
            roughness: arguments.number("roughness")?,
        },
        "NganWard" => {
            Specular::Ward { scale: albedo(&arguments)?, roughness: arguments.number("roughness")? }
        }
        "NganAshikhminShirley" => Specular::AshikhminShirley {
            scale: albedo(&arguments)?,
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
            scale: albedo(&arguments)?,
            alpha: arguments.rgb("alpha")?,
            power: arguments.rgb("p")?,
            fresnel: arguments.rows("eta")?,
            norm: arguments.rgb("K")?,
            masking: gamma_masking(&arguments)?,
        },
        other => return Err(format!("the lobe is {other}, expected {}", LOBES.join(", "))),
    };
    Ok((name.trim().to_owned(), Analytic::new(Parameters { diffuse, specular })?))
}

fn times(a: Rgb, b: Rgb) -> Rgb {
    std::array::from_fn(|channel| a[channel] * b[channel])
}

/// λ, s, k and θ₀ of [`Specular::ShiftedGamma`], which has sᵏ where the file has c.
fn gamma_masking(arguments: &Arguments) -> Result<[Rgb; 4], String> {
    let (c, k) = (arguments.rgb("c")?, arguments.rgb("k")?);
    for (name, values) in [("c", c), ("k", k)] {
        if let Some(x) = values.iter().find(|&&x| !(x > 0.0 && x.is_finite())) {
            return Err(format!("{name} is {x}, expected a number that is positive"));
        }
    }
    let s = std::array::from_fn(|channel| c[channel].powf(1.0 / k[channel]));
    Ok([arguments.rgb("Lambda")?, s, k, arguments.rgb("theta0")?])
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
        // Parameters are float32, as the library stores them, and those of Ngan et al. lack the channels' factors.
        let stored = |x: f64| f64::from(x as f32);
        let specular = Specular::Ward { scale: [0.01, 0.0, 0.5 * 1.66].map(stored), roughness: stored(0.02) };
        let diffuse = [0.1, 0.2 * 1.15, 0.3 * 1.66].map(stored);
        assert_eq!(*material.parameters(), Parameters { diffuse, specular });
    }

    #[test]
    fn rates_beyond_float32_are_kept_as_their_roots() {
        let line = "chrome = Aggregate(Lambertian(albedo = [0, 0, 0]), Bagher(albedo = [1, 1, 1], alpha = [1, 1, 1], \
                    p = [1, 1, 1], eta = [[1, 1, 1], [0, 0, 0]], K = [1, 1, 1], Lambda = [5, 5, 5], \
                    c = [1e100, 1.79834e66, 1e-8], k = [200, 272.736, 300], theta0 = [1, 1.00293, 1]))";
        let Specular::ShiftedGamma { masking: [_, s, ..], .. } = parse(line).unwrap().1.parameters().specular
        else {
            panic!("Bagher's lobe is the shifted gamma distribution")
        };
        for (s, expected) in s.into_iter().zip([10f64.powf(0.5), 1.749_551_6, 10f64.powf(-8.0 / 300.0)]) {
            assert!((s - expected).abs() < 1e-5 * expected, "{s} for {expected}");
        }
        assert!(parse(&line.replace("1e100", "-1")).unwrap_err().contains("c is -1, expected"));
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
