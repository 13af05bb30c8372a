//! A library's file, of which the header is read and the rest when it is asked for.

use serde_json::Value;

use super::Entry;
use super::codec::{Codec, Decoder};
use super::container::{Content, Tensors, read_header};
use super::header::{self, MaterialHeader, from_json};
use crate::kernels::network::Activation;
use crate::material::{Kind, Material, with_kind};

/// A file whose header has been read.
pub(super) struct OpenFile {
    pub kind: Kind,
    pub names: Vec<String>,
    pub digest: Option<String>,
    pub decoder: Decoder<Entry>,
}

impl OpenFile {
    pub fn new(content: Content, size: usize) -> Result<OpenFile, String> {
        let (metadata, start) = read_header(&content, size)?;
        let content = content.at_hand(start, size)?;
        let json = metadata.metadata().as_ref().and_then(|entries| entries.get("glimt"));
        let (header, names) = header::read(
            json.ok_or("its metadata has no entry \"glimt\"; it is some other safetensors file")?,
        )?;
        let kind: Kind = header
            .kind
            .parse()
            .map_err(|_| format!("its model is \"{}\", expected {}", header.kind, names_of_stored_kinds()))?;
        let activation = header.activation.as_deref().map(activation_named).transpose()?;
        let tensors = Tensors::new(content, (metadata, start), header.materials.len(), activation);
        let material = with_kind!(kind, Decoded => decoder::<Decoded>(&tensors, header.form.as_ref()))?;
        let (digest, materials) = (header.digest, header.materials);
        let decoder = move |i: usize| {
            let MaterialHeader { name, origin } = from_json(materials[i].get())?;
            Ok(Entry { name, material: material(i)?, origin })
        };
        Ok(OpenFile { kind, names, digest, decoder: Box::new(decoder) })
    }
}

fn decoder<M: Codec + 'static>(tensors: &Tensors, form: Option<&Value>) -> Result<Decoder<Material>, String>
where
    Material: From<M>,
{
    let decode = M::decoder(tensors, form)?;
    Ok(Box::new(move |i| decode(i).map(Material::from)))
}

/// The models that a library can hold, for messages.
fn names_of_stored_kinds() -> String {
    let is_stored = |&kind: &Kind| with_kind!(kind, Stored => Stored::STORED);
    let names: Vec<&str> = Kind::ALL.into_iter().filter(is_stored).map(Kind::name).collect();
    let (last, others) = names.split_last().expect("there are models");
    format!("{} or {last}", others.join(", "))
}

fn activation_named(name: &str) -> Result<Activation, String> {
    let expected = || Activation::ALL.map(Activation::name).join(" or ");
    Activation::named(name).ok_or_else(|| format!("its activation is \"{name}\", expected {}", expected()))
}
