//! Edits of a material's analytic part, as commands spell them.

use std::str::FromStr;

use anyhow::{Context, Result, bail};
use glimt_core::Material;

/// One change of k_d, η or α.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Edit {
    /// Diffuse albedo.
    Kd([f32; 3]),
    /// Relative index of refraction.
    Eta([f32; 3]),
    /// Roughness along x and y.
    Alpha([f32; 2]),
}

impl FromStr for Edit {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Edit> {
        let expected = "expected kd=R,G,B, eta=N or alpha=A, with one number for all or one for each";
        let (name, values) =
            text.split_once('=').with_context(|| format!("\"{text}\" is no edit, {expected}"))?;
        let numbers = values.split(',').map(|number| number.trim().parse::<f32>());
        let numbers: Vec<f32> = numbers
            .collect::<Result<_, _>>()
            .with_context(|| format!("\"{values}\" holds something that is no number, {expected}"))?;
        match name.trim() {
            "kd" => Ok(Edit::Kd(one_or_each(&numbers)?)),
            "eta" => Ok(Edit::Eta(one_or_each(&numbers)?)),
            "alpha" => Ok(Edit::Alpha(one_or_each(&numbers)?)),
            other => bail!("\"{other}\" is no parameter, {expected}"),
        }
    }
}

/// One number for all components, or one for each.
fn one_or_each<const N: usize>(numbers: &[f32]) -> Result<[f32; N]> {
    match numbers {
        [one] => Ok([*one; N]),
        _ => numbers
            .try_into()
            .with_context(|| format!("found {} numbers, expected one or {N}", numbers.len())),
    }
}

/// `material` of the name `name` with all of `edits`; the material itself if there are none.
pub fn apply(edits: &[Edit], name: &str, material: &Material) -> Result<Material> {
    if edits.is_empty() {
        return Ok(material.clone());
    }
    let Some(&microfacet) = material.microfacet() else {
        bail!("material \"{name}\": {} materials have no kd, eta or alpha to edit", material.kind());
    };
    let edited = edits.iter().fold(microfacet, |p, &edit| match edit {
        Edit::Kd(kd) => glimt_core::microfacet::Microfacet { kd, ..p },
        Edit::Eta(eta) => glimt_core::microfacet::Microfacet { eta, ..p },
        Edit::Alpha(alpha) => glimt_core::microfacet::Microfacet { alpha, ..p },
    });
    material.with_microfacet(edited).map_err(|reason| anyhow::anyhow!("material \"{name}\": {reason}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_are_read_as_they_are_documented() {
        let read = |text: &str| text.parse::<Edit>().unwrap();
        assert_eq!(read("alpha=0.2"), Edit::Alpha([0.2; 2]));
        assert_eq!(read("alpha=0.2,0.4"), Edit::Alpha([0.2, 0.4]));
        assert_eq!(read("kd=0.8, 0.2, 0.1"), Edit::Kd([0.8, 0.2, 0.1]));
        assert_eq!(read("eta=1.5"), Edit::Eta([1.5; 3]));
    }

    #[test]
    fn what_is_no_edit_is_named() {
        for (text, part) in
            [("alpha", "no edit"), ("rough=1", "\"rough\""), ("kd=1,2", "2 numbers"), ("eta=x", "\"x\"")]
        {
            let message = format!("{:#}", text.parse::<Edit>().unwrap_err());
            assert!(message.contains(part), "{message}");
        }
    }
}
