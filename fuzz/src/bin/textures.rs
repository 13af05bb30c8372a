#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    glimt_fuzz::readers::textures(bytes);
});
