#![no_main]

// The checksums are made right, or else nothing but them would be tested.
libfuzzer_sys::fuzz_target!(|content: &[u8]| {
    fmmgi_gpu_fuzz::read(&fmmgi_gpu_fuzz::sealed(content), ".e57");
});
