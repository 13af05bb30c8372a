//! How materials that vary over a surface are laid out in tensors.
//!
//! Numbers of texels are float32, float16 or 8 bits; of the latter the least and the greatest of every channel stand in
//! a tensor beside them.

use half::f16;
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::codec::{Codec, Decoder};
use super::container::{Tensor, Tensors, unexpected_shape};
#[cfg(test)]
use crate::kernels::network::tests::patterned_from;
use crate::kernels::network::{Activation, Network};
use crate::models::gated::texture::{Disk, Texture};
use crate::models::gated::{Angles, Base, FEATURES, Gated, LATENT, Linear, Parts};
use crate::models::maps::{FILED, Filter, Maps};
use crate::surface::{Layout, Precision, Pyramid, Range, Wrap};

/// What the metadata says of maps.
#[derive(Serialize, Deserialize)]
struct MapsForm {
    wrap: Wrap,
    filter: Filter,
    #[serde(default)]
    precision: Precision,
    /// Width and height of level 0, where the file has all levels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    size: Option<[usize; 2]>,
}

impl MapsForm {
    fn of(maps: &Maps) -> MapsForm {
        let size = (maps.filter() == Filter::Fitted).then(|| maps.size());
        MapsForm { wrap: maps.wrap(), filter: maps.filter(), precision: maps.precision(), size }
    }
}

const TYPES: [Dtype; 3] = [Dtype::F32, Dtype::F16, Dtype::U8];

/// Rows of `C` channels of each material, `shape` of them, and what their channels range over if they are 8 bits.
fn texels<const C: usize>(
    name: &str,
    shape: &[usize],
    materials: &[Vec<[f32; C]>],
    precision: Precision,
) -> Vec<Tensor> {
    let whole = [&[materials.len()], shape, &[C]].concat();
    let numbers = materials.iter().flatten().flatten();
    match precision {
        Precision::F32 => {
            let bytes = numbers.flat_map(|&x| x.to_le_bytes()).collect();
            vec![Tensor::typed(name, whole, Dtype::F32, bytes)]
        }
        Precision::F16 => {
            let bytes = numbers.flat_map(|&x| f16::from_f32(x).to_le_bytes()).collect();
            vec![Tensor::typed(name, whole, Dtype::F16, bytes)]
        }
        Precision::U8 => {
            let ranges: Vec<Range<C>> = materials.iter().map(|rows| Precision::range(rows)).collect();
            let steps = |(rows, range): (&Vec<[f32; C]>, &Range<C>)| -> Vec<u8> {
                rows.iter().flat_map(|row| range.encode(row)).collect()
            };
            let bytes = materials.iter().zip(&ranges).flat_map(steps).collect();
            let ends: Vec<f32> =
                ranges.iter().flat_map(|range| [range.least, range.greatest]).flatten().collect();
            vec![
                Tensor::typed(name, whole, Dtype::U8, bytes),
                Tensor::own(&format!("{name}.range"), vec![materials.len(), 2, C], &ends),
            ]
        }
    }
}

/// Reads the rows of a material that [`texels`] wrote. There are `shape` of them; where an axis is `None`, any number.
fn read_texels<const C: usize>(
    file: &Tensors,
    name: &str,
    material: usize,
    shape: &[Option<usize>],
) -> Result<(Vec<usize>, Vec<[f32; C]>), String> {
    let info = file.info(name, &TYPES)?;
    let fits = match &info.shape[..] {
        [materials, found @ .., channels] => {
            *materials == file.materials()
                && *channels == C
                && found.len() == shape.len()
                && shape.iter().zip(found).all(|(expected, found)| expected.is_none_or(|n| n == *found))
        }
        _ => false,
    };
    if !fits {
        let axes = shape.iter().map(|axis| axis.map_or("any".to_owned(), |n| n.to_string()));
        let expected = format!("[{}, {}, {C}]", file.materials(), axes.collect::<Vec<_>>().join(", "));
        return Err(unexpected_shape(name, &info.shape, &expected));
    }
    let found = info.shape[1..=shape.len()].to_vec();
    let count = found.iter().product::<usize>() * C;
    let bytes = count * info.dtype.bitsize() / 8;
    let bytes = file.part(name, material * bytes..(material + 1) * bytes)?;
    let numbers: Vec<f32> = match info.dtype {
        Dtype::F16 => bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
        Dtype::F32 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
        _ => {
            let ends = file.rows(&format!("{name}.range"), &[2, C])?.row(material)?;
            let (least, greatest) = ends.split_at(C);
            let range = Range {
                least: std::array::from_fn(|c| least[c]),
                greatest: std::array::from_fn(|c| greatest[c]),
            };
            bytes.as_chunks::<C>().0.iter().flat_map(|row| range.decode(row)).collect()
        }
    };
    match numbers.iter().position(|x| !x.is_finite()) {
        None => Ok((found, numbers.as_chunks::<C>().0.to_vec())),
        Some(at) => {
            let at = material * count + at;
            Err(format!(
                "the tensor \"{name}\" holds {} at index {at}, expected finite numbers",
                numbers[at - material * count]
            ))
        }
    }
}

impl Codec for Maps {
    fn form(&self) -> Option<Value> {
        Some(serde_json::to_value(MapsForm::of(self)).expect("a form is names and sizes"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let [width, height] = materials[0].size();
        let precision = materials[0].precision();
        let rows: Vec<Vec<[f32; FILED]>> =
            materials.iter().map(|maps| maps.rows(precision).collect()).collect();
        match materials[0].filter() {
            Filter::Average | Filter::Moments => texels("maps", &[height, width], &rows, precision),
            Filter::Fitted => texels("maps", &[materials[0].layout().texels()], &rows, precision),
        }
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a library of maps needs")?;
        let form: MapsForm = Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let file = file.clone();
        Ok(Box::new(move |i| decode_maps(&file, &form, i)))
    }

    #[cfg(test)]
    fn specimens(_: Activation) -> Vec<[Self; 2]> {
        use crate::models::maps::tests::patterned;
        let maps = || patterned(5, 3, Filter::Moments);
        let fitted =
            || Maps::of_levels(maps().layout().clone(), vec![maps().mean(); maps().layout().texels()]);
        let fitted = || fitted().expect("as many texels as there are").rounded(Precision::U8);
        let pairs = Precision::ALL.map(|precision| [maps().rounded(precision), maps().rounded(precision)]);
        [&pairs[..], &[[fitted(), fitted()]]].concat()
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        if self.size() == other.size() { Ok(()) } else { Err("have maps of different sizes".into()) }
    }
}

/// Most texels along a side.
const MOST_TEXELS: usize = 1 << 16;

/// Where texels of such a size are.
fn layout(size: [usize; 2], wrap: Wrap) -> Result<Layout, String> {
    if size.iter().all(|side| (1..=MOST_TEXELS).contains(side)) {
        return Ok(Layout::new(size, wrap));
    }
    let [width, height] = size;
    Err(format!("it has {width}×{height} texels, expected 1 to {MOST_TEXELS} along each side"))
}

/// The maps of a material.
fn decode_maps(file: &Tensors, form: &MapsForm, material: usize) -> Result<Maps, String> {
    let (layout, rows) = match (form.filter, form.size) {
        (Filter::Average | Filter::Moments, _) => {
            let (shape, rows) = read_texels(file, "maps", material, &[None, None])?;
            (layout([shape[1], shape[0]], form.wrap)?, rows)
        }
        (Filter::Fitted, Some(size)) => {
            let layout = layout(size, form.wrap)?;
            let (_, rows) = read_texels(file, "maps", material, &[Some(layout.texels())])?;
            (layout, rows)
        }
        (Filter::Fitted, None) => {
            return Err("its metadata has no \"size\", which maps of fitted levels need".into());
        }
    };
    Ok(Maps::of_file(&layout, rows, form.filter, form.precision)?)
}

/// What the metadata says of a gated surface.
#[derive(Serialize, Deserialize)]
struct GatedForm {
    #[serde(flatten)]
    maps: MapsForm,
    base: Base,
    angles: Angles,
    /// Width and height of level 0 of the latent codes.
    latents: [usize; 2],
    half: Disk,
    difference: Disk,
    frames: bool,
    warps: bool,
}

impl Codec for Gated {
    fn form(&self) -> Option<Value> {
        let parts = self.parts();
        let form = GatedForm {
            maps: MapsForm::of(&parts.maps),
            base: parts.base,
            angles: parts.angles,
            latents: parts.latents.layout().size(),
            half: parts.half.disk(),
            difference: parts.difference.disk(),
            frames: parts.frames.is_some(),
            warps: parts.warps.is_some(),
        };
        Some(serde_json::to_value(form).expect("a form is names and sizes"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let parts: Vec<&Parts> = materials.iter().map(|material| material.parts()).collect();
        let first = parts[0];
        let precision = first.maps.precision();
        let mut tensors = Maps::encode(&parts.iter().map(|parts| &parts.maps).collect::<Vec<_>>());
        let latents: Vec<_> = parts.iter().map(|parts| parts.latents.all_texels().to_vec()).collect();
        tensors.extend(texels("latents", &[latents[0].len()], &latents, precision));
        let textures: [(&str, fn(&Parts) -> &Texture); 2] =
            [("half", |parts| &parts.half), ("difference", |parts| &parts.difference)];
        for (name, texture) in textures {
            let shape = [texture(first).disk().texels(), first.angles.columns()];
            let numbers: Vec<_> = parts.iter().map(|parts| texture(parts).numbers().to_vec()).collect();
            tensors.extend(texels(name, &shape, &numbers, precision));
        }
        tensors.extend(
            linear_tensors("frames", parts.iter().filter_map(|p| p.frames.as_ref())).into_iter().flatten(),
        );
        tensors.extend(
            linear_tensors("warps", parts.iter().filter_map(|p| p.warps.as_ref())).into_iter().flatten(),
        );
        let bounds: Vec<f32> = parts.iter().map(|parts| parts.bound).collect();
        tensors.push(Tensor::own("bound", vec![bounds.len()], &bounds));
        let networks: Vec<&Network> = parts.iter().map(|parts| &parts.network).collect();
        tensors.extend(super::codec::layers_tensors(&networks, true));
        tensors
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a gated surface needs")?;
        let form: GatedForm = Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let file = file.clone();
        Ok(Box::new(move |i| Ok(Gated::new(decode_parts(&file, &form, i)?)?)))
    }

    #[cfg(test)]
    fn specimens(activation: Activation) -> Vec<[Self; 2]> {
        use crate::models::gated::tests::patterned;
        let pair = |base, angles| {
            let network = patterned_from(3, &[angles, 16, 6], angles, activation);
            [patterned(base, network.clone()), patterned(base, network)]
        };
        vec![pair(Base::Maps, 16), pair(Base::Maps, 24)]
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        self.parts().maps.check_together(&other.parts().maps)
    }
}

/// What a gated surface is made of.
fn decode_parts(file: &Tensors, form: &GatedForm, material: usize) -> Result<Parts, String> {
    let maps = decode_maps(file, &form.maps, material)?;
    let layout = layout(form.latents, form.maps.wrap)?;
    let (_, latents) = read_texels::<LATENT>(file, "latents", material, &[Some(layout.texels())])?;
    let latents = Pyramid::of_levels(layout, latents)?;
    let texture = |name: &str, disk: Disk| -> Result<Texture, String> {
        disk.check()?;
        let columns = form.angles.columns();
        let shape = [Some(disk.texels()), Some(columns)];
        Ok(Texture::new(disk, columns, read_texels::<FEATURES>(file, name, material, &shape)?.1)?)
    };
    let networks = file.networks(form.angles.inputs(), Activation::HardGelu)?;
    Ok(Parts {
        base: form.base,
        angles: form.angles,
        maps,
        latents,
        frames: form.frames.then(|| read_linear(file, "frames", material)).transpose()?,
        warps: form.warps.then(|| read_linear(file, "warps", material)).transpose()?,
        half: texture("half", form.half)?,
        difference: texture("difference", form.difference)?,
        network: Network::clone(&*networks.of_material(material)?),
        bound: file.rows("bound", &[])?.number(material)?,
    })
}

fn linear_tensors<'a, const N: usize>(
    name: &str,
    linear: impl Iterator<Item = &'a Linear<N>>,
) -> Option<[Tensor; 2]> {
    let linear: Vec<&Linear<N>> = linear.collect();
    let weights: Vec<f32> = linear.iter().flat_map(|linear| linear.weight.as_flattened()).copied().collect();
    let biases: Vec<f32> = linear.iter().flat_map(|linear| linear.bias).collect();
    (!linear.is_empty()).then(|| {
        [
            Tensor::own(&format!("{name}.weight"), vec![linear.len(), N, LATENT], &weights),
            Tensor::own(&format!("{name}.bias"), vec![linear.len(), N], &biases),
        ]
    })
}

fn read_linear<const N: usize>(file: &Tensors, name: &str, material: usize) -> Result<Linear<N>, String> {
    let weight = file.rows(&format!("{name}.weight"), &[N, LATENT])?.row(material)?;
    let bias = file.rows(&format!("{name}.bias"), &[N])?.array(material)?;
    Ok(Linear { weight: std::array::from_fn(|i| std::array::from_fn(|k| weight[i * LATENT + k])), bias })
}
