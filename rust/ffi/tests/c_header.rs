//! The headers in `cpp/include/glimt` are generated from `src/status.rs`, `src/c_api.rs` and `src/image_api.rs` and checked in, so
//! that a C program needs no Rust tool to read them. After a change of the interface:
//!
//! ```sh
//! GLIMT_WRITE_HEADER=1 cargo test -p glimt-ffi --test c_header
//! ```

use std::path::Path;

const BRDF_PREAMBLE: &str = "\
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

const IMAGE_PREAMBLE: &str = "\
/* Images of glimt: OpenEXR files for programs that render with it. What glimt.h says of pointers, strings and
   errors holds here.

   Generated from rust/ffi/src/image_api.rs. */
";

struct Header {
    file: &'static str,
    sources: &'static [&'static str],
    preamble: &'static str,
    guard: &'static str,
    system_includes: &'static [&'static str],
    includes: &'static [&'static str],
}

const HEADERS: [Header; 2] = [
    Header {
        file: "glimt.h",
        sources: &["status.rs", "c_api.rs"],
        preamble: BRDF_PREAMBLE,
        guard: "GLIMT_H",
        system_includes: &["stdbool.h", "stddef.h"],
        includes: &[],
    },
    Header {
        file: "image.h",
        sources: &["image_api.rs"],
        preamble: IMAGE_PREAMBLE,
        guard: "GLIMT_IMAGE_H",
        system_includes: &["stddef.h"],
        includes: &["glimt.h"],
    },
];

fn generate(header: &Header) -> String {
    let config = cbindgen::Config {
        language: cbindgen::Language::C,
        cpp_compat: true,
        header: Some(header.preamble.trim_end().to_owned()),
        include_guard: Some(header.guard.to_owned()),
        no_includes: true,
        sys_includes: header.system_includes.iter().map(ToString::to_string).collect(),
        includes: header.includes.iter().map(ToString::to_string).collect(),
        documentation_style: cbindgen::DocumentationStyle::Doxy,
        usize_is_size_t: true,
        line_length: 100,
        function: cbindgen::FunctionConfig {
            args: cbindgen::Layout::Auto,
            ..cbindgen::FunctionConfig::default()
        },
        ..cbindgen::Config::default()
    };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let sources = header.sources.iter().map(|source| folder.join(source));
    let builder = sources.fold(cbindgen::Builder::new().with_config(config), cbindgen::Builder::with_src);
    let bindings = builder.generate().unwrap();
    let mut text = Vec::new();
    bindings.write(&mut text);
    String::from_utf8(text).unwrap()
}

#[test]
fn headers_are_current() {
    for header in &HEADERS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../cpp/include/glimt");
        let path = folder.join(header.file);
        let generated = generate(header);
        if std::env::var_os("GLIMT_WRITE_HEADER").is_some() {
            std::fs::write(&path, &generated).unwrap();
        }
        let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            checked_in == generated,
            "{} is not what src/{} says; write it anew with GLIMT_WRITE_HEADER=1",
            path.display(),
            header.sources.join(", ")
        );
    }
}
