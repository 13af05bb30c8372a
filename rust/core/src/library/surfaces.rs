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
use crate::models::maps::{FILED, Filter, Maps, Texel};
use crate::surface::{Layout, Precision, Pyramid, Range, Wrap};

/// What the metadata says of maps.
#[derive(Serialize, Deserialize)]
struct MapsForm {
    wrap: Wrap,
    filter: Filter,
    #[serde(default)]
    precision: Precision,
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
        let form = MapsForm { wrap: self.wrap(), filter: self.filter(), precision: self.precision() };
        Some(serde_json::to_value(form).expect("a form is names"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let [width, height] = materials[0].size();
        let precision = materials[0].precision();
        let rows: Vec<Vec<[f32; FILED]>> =
            materials.iter().map(|maps| maps.rows(precision).collect()).collect();
        texels("maps", &[height, width], &rows, precision)
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
        Precision::ALL.map(|precision| [maps().rounded(precision), maps().rounded(precision)]).to_vec()
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        if self.size() == other.size() { Ok(()) } else { Err("have maps of different sizes".into()) }
    }
}

/// The maps of a material.
fn decode_maps(file: &Tensors, form: &MapsForm, material: usize) -> Result<Maps, String> {
    let (shape, rows) = read_texels::<FILED>(file, "maps", material, &[None, None])?;
    let width = shape[1];
    let texels = rows.iter().map(|&row| Texel::from_file(row, form.precision));
    Ok(Maps::new(width, texels, form.wrap, form.filter)?.with_precision(form.precision))
}

/// What the metadata says of a gated surface.
#[derive(Serialize, Deserialize)]
struct GatedForm {
    #[serde(flatten)]
    maps: MapsForm,
    base: Base,
    angles: Angles,
    /// Width and height of level 0 of the latent codes.
    size: [usize; 2],
    half: Disk,
    difference: Disk,
    frames: bool,
    warps: bool,
}

impl Codec for Gated {
    fn form(&self) -> Option<Value> {
        let parts = self.parts();
        let form = GatedForm {
            maps: MapsForm {
                wrap: parts.maps.wrap(),
                filter: parts.maps.filter(),
                precision: parts.maps.precision(),
            },
            base: parts.base,
            angles: parts.angles,
            size: parts.latents.layout().size(),
            half: parts.half.disk(),
            difference: parts.difference.disk(),
            frames: parts.frames.is_some(),
            warps: parts.warps.is_some(),
        };
        Some(serde_json::to_value(form).expect("a form is names and sizes"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let parts = materials[0].parts();
        let precision = parts.maps.precision();
        let mut tensors = Maps::encode(&[&parts.maps]);
        let latents = parts.latents.all_texels().to_vec();
        tensors.extend(texels("latents", &[latents.len()], &[latents], precision));
        for (name, texture) in [("half", &parts.half), ("difference", &parts.difference)] {
            let shape = [texture.disk().texels(), parts.angles.columns()];
            tensors.extend(texels(name, &shape, &[texture.numbers().to_vec()], precision));
        }
        tensors.extend(parts.frames.iter().flat_map(|frames| linear_tensors("frames", frames)));
        tensors.extend(parts.warps.iter().flat_map(|warps| linear_tensors("warps", warps)));
        tensors.push(Tensor::own("bound", vec![1], &[parts.bound]));
        tensors.extend(super::codec::layers_tensors(&[&parts.network], false));
        tensors
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a gated surface needs")?;
        let form: GatedForm = Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        if file.materials() != 1 {
            return Err(format!("it holds {} gated surfaces, expected one a file", file.materials()));
        }
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

    fn check_together(&self, _: &Self) -> Result<(), String> {
        Err("are gated surfaces, of which a library holds one".into())
    }
}

/// What a gated surface is made of.
fn decode_parts(file: &Tensors, form: &GatedForm, material: usize) -> Result<Parts, String> {
    let maps = decode_maps(file, &form.maps, material)?;
    const MOST: usize = 1 << 16;
    let [width, height] = form.size;
    if !(1..=MOST).contains(&width) || !(1..=MOST).contains(&height) {
        return Err(format!("its latent codes have a size of {width}×{height}, expected 1 to {MOST} each"));
    }
    let layout = Layout::new(form.size, form.maps.wrap);
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
        frames: form.frames.then(|| read_linear(file, "frames")).transpose()?,
        warps: form.warps.then(|| read_linear(file, "warps")).transpose()?,
        half: texture("half", form.half)?,
        difference: texture("difference", form.difference)?,
        network: Network::clone(&*networks.of_material(material)?),
        bound: file.rows("bound", &[])?.number(material)?,
    })
}

fn linear_tensors<const N: usize>(name: &str, linear: &Linear<N>) -> [Tensor; 2] {
    [
        Tensor::own(&format!("{name}.weight"), vec![1, N, LATENT], linear.weight.as_flattened()),
        Tensor::own(&format!("{name}.bias"), vec![1, N], &linear.bias),
    ]
}

fn read_linear<const N: usize>(file: &Tensors, name: &str) -> Result<Linear<N>, String> {
    let weight = file.rows(&format!("{name}.weight"), &[N, LATENT])?.row(0)?;
    let bias = file.rows(&format!("{name}.bias"), &[N])?.array(0)?;
    Ok(Linear { weight: std::array::from_fn(|i| std::array::from_fn(|k| weight[i * LATENT + k])), bias })
}
