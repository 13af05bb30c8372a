//! What the fuzz targets run; `rust/files/tests/hostile.rs` replays the corpus through the same.

pub mod readers;
