//! `cpp/include/glimt/glimt.h` is generated from `src/c_api.rs` and checked in, so that a C program needs
//! no Rust tool to read it. After a change of the interface:
//!
//! ```sh
//! GLIMT_WRITE_HEADER=1 cargo test -p glimt-ffi --test c_header
//! ```

use std::path::Path;

const PREAMBLE: &str = "\
/* glimt: compact and neural BRDFs, fitted to measured reflectance.

   A model library is opened once, and its materials answer f, pdf and samples. Objects are
   immutable, so that any number of threads may use them at once.

   Directions are unit vectors in the local shading frame, right-handed, with the normal +z. Both
   point away from the surface: light to where the energy comes from, view to where it goes.
   Colours are linear RGB.

   Pointers must be valid for what the function says of them. Where NULL is not allowed, a function
   that returns a status answers GLIMT_ERROR_ARGUMENT to it. Strings end with a zero byte. Every
   error leaves a message in glimt_last_error().

   Generated from rust/ffi/src/c_api.rs. */
";

fn generate() -> String {
    let config = cbindgen::Config {
        language: cbindgen::Language::C,
        cpp_compat: true,
        header: Some(PREAMBLE.trim_end().to_owned()),
        include_guard: Some("GLIMT_H".to_owned()),
        no_includes: true,
        sys_includes: ["stdbool.h", "stddef.h"].map(str::to_owned).to_vec(),
        documentation_style: cbindgen::DocumentationStyle::Doxy,
        usize_is_size_t: true,
        line_length: 100,
        function: cbindgen::FunctionConfig {
            args: cbindgen::Layout::Auto,
            ..cbindgen::FunctionConfig::default()
        },
        ..cbindgen::Config::default()
    };
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/c_api.rs");
    let bindings = cbindgen::Builder::new().with_config(config).with_src(source).generate().unwrap();
    let mut header = Vec::new();
    bindings.write(&mut header);
    String::from_utf8(header).unwrap()
}

#[test]
fn header_is_current() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../cpp/include/glimt/glimt.h");
    let header = generate();
    if std::env::var_os("GLIMT_WRITE_HEADER").is_some() {
        std::fs::write(&path, &header).unwrap();
    }
    let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        checked_in == header,
        "{} is not what src/c_api.rs says; write it anew with GLIMT_WRITE_HEADER=1",
        path.display()
    );
}
