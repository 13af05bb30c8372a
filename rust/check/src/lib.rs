//! Does a BSDF do what it says? Conformance tests for any BSDF, and a named catalogue of extreme inputs.
