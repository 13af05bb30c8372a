//! Names the shared library for the dynamic linker.

use std::env::var;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // Versions that differ in the minor number are other interfaces as long as the major number is 0. What rustc
    // exports from a shared library is what `no_mangle` marks: it writes the linker's version script itself.
    if var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "linux") {
        let [major, minor] =
            ["MAJOR", "MINOR"].map(|part| var(format!("CARGO_PKG_VERSION_{part}")).unwrap_or_default());
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libglimt.so.{major}.{minor}");
    }
}
