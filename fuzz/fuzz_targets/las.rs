#![no_main]

// What the decompressor panics at, the reader catches and reports: libFuzzer's own hook would end the
// run before that.
libfuzzer_sys::fuzz_target!(
    init: drop(std::panic::take_hook()),
    |content: &[u8]| fmmgi_gpu_fuzz::read(content, ".las")
);
