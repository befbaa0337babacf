#![no_main]

libfuzzer_sys::fuzz_target!(|content: &[u8]| fmmgi_gpu_fuzz::read(content, ".las"));
