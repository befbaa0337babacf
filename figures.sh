#!/usr/bin/env bash
# Every figure that README.md quotes, found anew: `./figures.sh` for all of them (a few hours),
# `./figures.sh NAME...` for some. What is printed is kept in target/figures/NAME.txt; pictures and
# docs/stability.md are written where the README shows them.
#
# Let nothing else run beside it. `large` and `sky` are of scans of your own:
# ROOM=room.laz STATUE=statue.ply ./figures.sh large sky
set -euo pipefail
cd "$(dirname "$0")"

all=(picture exact surface tolerance growth blocks lights walls stability rays visibility open order benches chart choices large sky scans)
scenes=(cornell organic two_rooms cave)
out=target/figures
mkdir -p "$out"
program=target/release/fmmgi-gpu

solve() { "$program" solve "$@" --backend cpu; }
tests() { cargo test --release "$@" -- --include-ignored --nocapture --test-threads 1; }
clock() { TIMEFORMAT='%R s'; time "$@"; }

# The pictures at the top and of the report's method.
picture() {
    clock solve scenes/cornell.toml --points 200000 --image docs/cornell.png --size 640x540
    cargo run --release --example figure_2_10 -- docs/figure_2_10.png
}

# Methods against exact sums.
exact() {
    for scene in "${scenes[@]}"; do
        for method in direct fmm gather classic; do
            echo "== $scene, $method"
            clock solve "scenes/$scene.toml" --points 10000 --method "$method" -o "$out/$method.ply"
            [[ $method = direct ]] || "$program" compare "$out/$method.ply" "$out/direct.ply"
        done
    done
}

surface() { tests --test surface_truth --test noise; }

tolerance() {
    cargo run --release --example tolerance
    while read -r scene points tolerance; do
        echo "== $scene, $points points, $tolerance"
        clock solve "scenes/$scene.toml" --points "$points" --tolerance "$tolerance" -v -o "$out/lit.ply"
    done <<<"cornell 128000 0.02
organic 128000 0.02
cave 128000 0.025
cornell 1000000 0.02
cornell 20000 0.02
cornell 200000 0.02
cornell 2000000 0.02"
}

growth() { cargo bench --bench growth; }
blocks() { tests --test even; }
lights() { cargo bench --bench relight; }
walls() { tests --test walls --test curved --test contact --test cave_scan; }
stability() { cargo test --release --test stability page -- --ignored --nocapture; }
rays() { tests --test gather; }
visibility() { tests --test point_visible --test classic --test visibility; }
open() {
    cargo bench --bench figure_2_11
    clock solve scenes/room.toml --points 100000 --tolerance 0.003
    clock solve scenes/room.toml --points 100000 --tolerance 0.003 --method fmm
    clock solve scenes/furnace.toml --points 100000 --tolerance 0.01
}
order() { tests --test smooth; }

benches() {
    for bench in solve visibility; do cargo bench --bench "$bench"; done
    for bench in stages p2p; do cargo bench --bench "$bench" -- --quick; done
}

chart() {
    "$program" chart -o "$out/chart"
    for picture in error_time growth order stages; do
        cp "$out/chart/$picture.svg" "docs/chart_$picture.svg"
    done
}

choices() { cargo bench --bench choices; }

large() {
    if [[ -z ${ROOM-} ]]; then
        echo "left out: name a scanned room, ROOM=room.laz"
        return
    fi
    clock solve "$ROOM" --light point:-0.7,-0.7,2.5 --normals inward -v --stats "$out/large.json" -o "$out/large.ply"
}

sky() {
    if [[ -z ${STATUE-} ]]; then
        echo "left out: name a scanned statue, STATUE=statue.ply"
        return
    fi
    clock solve "$STATUE" --sky 1,1,1 --normals outward
    clock solve "$STATUE" --sky 1,1,1 --light point:3,4,5 --normals outward --tolerance 0.01
}

# Virtual scans with truth: a folder of NAME_LEVEL.laz, .e57, NAME.ref.csv and compare.py.
scans() {
    local folder=${VIRTUAL-../shared/virtual} name level file truth
    if [[ ! -d $folder ]]; then
        echo "left out: name a folder of virtual scans, VIRTUAL=folder"
        return
    fi
    declare -A lights=(
        [chapel]="--light point:4,7,4.5:30,27,22 --light point:1,1.2,2:8,7,6"
        [courtyard]="--light point:6,11.3,2.9:6,5,4 --sky 1,1,1"
        [workshop]="--light point:4.2,4.6,3.6:40,38,34"
    )
    for name in chapel courtyard workshop; do
        for file in A.laz C.laz D.laz D.e57; do
            level=${file%%.*}
            truth=$folder/$name.ref.csv
            [[ $level == D ]] && truth=$folder/${name}_D.ref.csv
            printf '%s %s\n' "$name" "$file"
            # shellcheck disable=SC2086
            "$program" solve "$folder/${name}_$file" ${lights[$name]} --backend cpu -o "$out/lit.ply" | grep -E '^(time|error|surface)' || true
            python3 "$folder/compare.py" "$truth" "$out/lit.ply"
        done
    done
}

names=("$@")
[[ $# -gt 0 ]] || names=("${all[@]}")
for name in "${names[@]}"; do
    if [[ " ${all[*]} " != *" $name "* ]]; then
        echo "no figures of that name: $name (there are ${all[*]})" >&2
        exit 2
    fi
done
cargo build --release --bins --examples
for name in "${names[@]}"; do
    printf '\n== %s\n' "$name"
    "$name" 2>&1 | tee "$out/$name.txt" || echo "$name: ended with an error"
done
