#!/usr/bin/env bash
# Everything that must hold: format, lints, tests, documentation examples, benches that compile.
#
# Tests of GPU code need an adapter. Where there is none, software Vulkan is installed (with apt,
# as root or through sudo); where that is not possible, those tests fail and say what they need.
# They run a second time on another driver, SwiftShader, where Debian's packages have it: it differs
# in the size of subgroups, in denormals and in what it reads out of bounds.
set -euo pipefail
cd "$(dirname "$0")"

# Without a desktop, Mesa's choice of a device complains of having none.
export NODEVICE_SELECT="${NODEVICE_SELECT-1}"

# The same random cases in every run; plain `cargo test` draws new ones.
export PROPTEST_RNG_SEED="${PROPTEST_RNG_SEED-1}"

step() { printf '\n== %s\n' "$*"; }

has_adapter() {
    ! cargo run --release --quiet -- adapters | grep --quiet '^no adapter'
}

install_software_vulkan() {
    local as_root=()
    if [[ $(id -u) -ne 0 ]]; then
        as_root=(sudo)
    fi
    command -v apt-get >/dev/null &&
        "${as_root[@]}" apt-get update &&
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get install --yes --no-install-recommends mesa-vulkan-drivers libvulkan1
}

# Unpacks SwiftShader from Chromium's package, which need not be installed.
swiftshader=target/swiftshader/usr/lib/chromium/vk_swiftshader_icd.json
fetch_swiftshader() {
    [[ -f $swiftshader ]] && return
    command -v apt-get dpkg >/dev/null || return
    mkdir -p target/swiftshader
    (cd target/swiftshader && apt-get download chromium-common && dpkg -x chromium-common_*.deb .) &&
        [[ -f $swiftshader ]]
}

if cargo fmt --version >/dev/null 2>&1; then
    step format
    cargo fmt --check
else
    step "format: left out (rustup component add rustfmt)"
fi

if cargo clippy --version >/dev/null 2>&1; then
    step lints
    # Another version of clippy may warn of more: that fails in continuous integration only.
    cargo clippy --release --all-targets -- ${CI:+-D warnings}
else
    step "lints: left out (rustup component add clippy)"
fi

step adapter
if ! has_adapter; then
    echo "no GPU and no software Vulkan: installing mesa-vulkan-drivers and libvulkan1"
    if ! install_software_vulkan; then
        echo "that was not possible: install the driver of your GPU, or software Vulkan (lavapipe, a"
        echo "part of Mesa), yourself. Until then the tests of GPU code will fail."
    fi
fi
cargo run --release --quiet -- adapters

step tests
cargo test --release --no-fail-fast

step "tests on another driver"
if fetch_swiftshader; then
    VK_DRIVER_FILES="$PWD/$swiftshader" VK_ICD_FILENAMES="$PWD/$swiftshader" \
        cargo test --release --no-fail-fast --test device --test gather_method --test gpu_operator \
        --test gpu_solve --test gpu_stages --test p2p --test point_visible --test segments --test visibility
else
    echo "left out: SwiftShader is in Debian's package chromium-common, which cannot be had here"
fi

step benches
cargo bench --no-run

step "all passed in $((SECONDS / 60)) min $((SECONDS % 60)) s"
