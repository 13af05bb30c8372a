//! Writes the catalogue of extreme inputs for tests in other languages, with the answers of the core.
//!
//!     cargo run --release -p glimt-check --example export_catalogue -- DIRECTORY
//!
//! Float32, little-endian: `pairs.raw` holds (n, 6), light and view; beside each file `FILE.f.raw` (n, 3),
//! evaluated as a batch, `FILE.one.raw` (n, 3), one by one, and `FILE.pdf.raw` (n). `families.txt` names the family
//! of each pair, `files.txt` each file and, after a tab, the sampler to ask for.

use std::path::Path;

use glimt_check::extremes::{families, save_files};
use glimt_check::stability::eval_batch;
use glimt_core::{Brdf, SampleBrdf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = std::env::args().nth(1).ok_or("expected the directory to write to")?;
    let directory = &std::path::absolute(directory)?;
    let mut names = String::new();
    let mut pairs = Vec::new();
    for family in families() {
        names.push_str(&format!("{}\n", family.name).repeat(family.pairs.len()));
        pairs.extend(family.pairs);
    }
    std::fs::write(directory.join("families.txt"), names)?;
    let write = |name: &Path, values: Vec<f32>| {
        std::fs::write(directory.join(name), values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
    };
    let flat = pairs.iter().flat_map(|(l, v)| [l.x, l.y, l.z, v.x, v.y, v.z]);
    write(Path::new("pairs.raw"), flat.collect())?;
    let mut files = String::new();
    for (path, case) in save_files(directory)? {
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        files.push_str(&format!("{file}\t{}\n", case.sampler));
        let batch = eval_batch(&case.material, &pairs).into_iter().flat_map(|f| f.to_array());
        write(&path.with_extension("f.raw"), batch.collect())?;
        let singles = pairs.iter().flat_map(|&(l, v)| case.material.eval(l, v).to_array());
        write(&path.with_extension("one.raw"), singles.collect())?;
        write(
            &path.with_extension("pdf.raw"),
            pairs.iter().map(|&(l, v)| case.material.pdf(l, v)).collect(),
        )?;
    }
    std::fs::write(directory.join("files.txt"), files)?;
    Ok(())
}
