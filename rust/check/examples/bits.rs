//! Prints a digest of the bits of eval, pdf and sample of every model's materials, a line each. A change of shape that
//! changes no number leaves the lines as they were:
//!
//!     cargo run --release -p glimt-check --example bits -- scenes/models/*.safetensors > before
//!     (the change)
//!     cargo run --release -p glimt-check --example bits -- scenes/models/*.safetensors | diff before -
//!
//! Besides the libraries that are named, the catalogue's materials are asked. `GLIMT_ISA` chooses the instruction
//! set. Lines of two machines may differ: samplers are chosen with the logarithms of the machine's C library.

use std::fmt::Display;

use glimt_check::extremes::parts;
use glimt_core::brdf::lane_of;
use glimt_core::microfacet::Microfacet;
use glimt_core::simd::{LANES, Lane3, isa_name};
use glimt_core::{Brdf, Library, Material, SampleBrdf, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Pairs of a material; samples are a tenth of them.
const PAIRS: usize = 10_000;

fn main() {
    println!("instruction set: {}", isa_name());
    let pairs = Pairs::new();
    for part in parts() {
        for case in (part.cases)() {
            print(&format!("{} {}", part.kind, case.name), &case.material, &pairs);
        }
    }
    for path in std::env::args().skip(1) {
        let library = Library::open(&path).unwrap_or_else(|error| panic!("{error}"));
        let materials: Vec<&Material> = library.entries().iter().map(|entry| &entry.material).collect();
        for entry in library.entries() {
            print(&entry.name, &entry.material, &pairs);
            if let Some(edited) = edited(&entry.material) {
                print(&format!("{}, edited", entry.name), &edited, &pairs);
            }
        }
        println!("{path} mixed: {}", mixed_tiles(&materials, &pairs));
    }
}

/// A rougher and darker material, where there is something to edit.
fn edited(material: &Material) -> Option<Material> {
    let p = material.microfacet()?;
    let edited = Microfacet { kd: p.kd.map(|kd| 0.5 * kd), alpha: p.scaled_alpha(1.7), ..*p };
    material.with_microfacet(edited).ok()
}

/// Directions of every elevation, one in sixteen below the horizon, and numbers to sample with.
struct Pairs {
    light: Vec<Vec3>,
    view: Vec<Vec3>,
    u: Vec<Vec3>,
}

impl Pairs {
    fn new() -> Pairs {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let mut direction = || {
            let z = random.random_range(-0.0625..1.0f32);
            let phi = random.random_range(0.0..std::f32::consts::TAU);
            // Every other one is pushed towards the horizon.
            let z = if random.random() { z } else { z * z * z };
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        };
        let light = (0..PAIRS).map(|_| direction()).collect();
        let view = (0..PAIRS).map(|_| direction()).collect();
        let u = (0..PAIRS / 10).map(|_| Vec3::from(std::array::from_fn(|_| random.random()))).collect();
        Pairs { light, view, u }
    }
}

fn print(name: &str, material: &Material, Pairs { light, view, u }: &Pairs) {
    let mut eval = Digest::new();
    let mut f = vec![Vec3::ZERO; PAIRS];
    material.eval_batch(light, view, &mut f);
    eval.vectors(&f);
    for (&light, &view) in light.iter().zip(view) {
        eval.vectors(&[material.eval(light, view)]);
    }
    for (first, (light, view)) in light.chunks_exact(LANES).zip(view.chunks_exact(LANES)).enumerate() {
        let (light, view) = (components(light), components(view));
        // Packets of every width that kernels have.
        let width = [4, 8, 11, 16][first % 4];
        let of_width = |tile: &Lane3| tile.map(|component| component[..width].to_vec());
        let (light, view) = (of_width(&light), of_width(&view));
        let mut out = [[0.0; LANES]; 3];
        let [red, green, blue] = &mut out;
        let sides = [&light, &view].map(|side| side.each_ref().map(|x| &x[..]));
        material.eval_packet(
            sides[0],
            sides[1],
            [&mut red[..width], &mut green[..width], &mut blue[..width]],
        );
        eval.numbers(out.as_flattened());
    }
    let (mut pdf, mut sample) = (Digest::new(), Digest::new());
    for (&light, &view) in light.iter().zip(view).take(u.len()) {
        pdf.numbers(&[material.pdf(light, view)]);
    }
    for (&u, &view) in u.iter().zip(view) {
        let s = material.sample(view, u);
        sample.vectors(&[s.light, s.weight]);
        sample.numbers(&[s.pdf]);
    }
    println!("{name}: eval {eval}, pdf {pdf}, sample {sample}");
}

/// Tiles whose lanes belong to different materials.
fn mixed_tiles(materials: &[&Material], Pairs { light, view, .. }: &Pairs) -> impl Display {
    let mut digest = Digest::new();
    for (tile, (light, view)) in light.chunks_exact(LANES).zip(view.chunks_exact(LANES)).enumerate() {
        let first = materials[tile % materials.len()];
        let of_lane = std::array::from_fn(|lane| {
            let material = materials[(tile + lane / 2 * 7) % materials.len()];
            if first.shares_tiles_with(material) { material } else { first }
        });
        let mut out = [[0.0; LANES]; 3];
        Material::eval_mixed_tile(&of_lane, &components(light), &components(view), &mut out);
        for lane in 0..LANES {
            digest.vectors(&[lane_of(&out, lane)]);
        }
    }
    digest
}

fn components(vectors: &[Vec3]) -> Lane3 {
    std::array::from_fn(|c| std::array::from_fn(|lane| vectors[lane][c]))
}

/// The 64-bit FNV-1a hash (Fowler, Noll, Vo) of numbers' bits.
struct Digest(u64);

impl Digest {
    fn new() -> Digest {
        Digest(0xcbf2_9ce4_8422_2325)
    }

    fn numbers(&mut self, numbers: &[f32]) {
        for byte in numbers.iter().flat_map(|x| x.to_bits().to_le_bytes()) {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn vectors(&mut self, vectors: &[Vec3]) {
        vectors.iter().for_each(|v| self.numbers(&v.to_array()));
    }
}

impl Display for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}
