#!/usr/bin/env bash
# Runs targets one after another, each for so many seconds: run.sh SECONDS [TARGET...]. Stops at a finding.
# The instrumentation is cargo-fuzz's, so that the stable compiler and nothing else is needed.
set -euo pipefail
cd "$(dirname "$0")"
seconds="${1:?seconds per target}"
shift
targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=(obj ply npz smpl_npz bvh asf_amc safetensors)

export RUSTC_BOOTSTRAP=1
RUSTFLAGS="-Cpasses=sancov-module"
for option in level=4 inline-8bit-counters pc-table trace-compares; do
  RUSTFLAGS+=" -Cllvm-args=-sanitizer-coverage-$option"
done
RUSTFLAGS+=" --cfg fuzzing -Clink-dead-code -Cdebug-assertions -Ccodegen-units=1"
export RUSTFLAGS
# With a target of its own, build scripts and macros are left alone.
host="$(rustc -vV | sed -n 's/^host: //p')"
cargo build --release --target "$host" "${targets[@]/#/--bin=}"

python3 seeds.py
mkdir -p logs artifacts
for target in "${targets[@]}"; do
  mkdir -p "corpus/$target" "artifacts/$target"
  "${CARGO_TARGET_DIR:-target}/$host/release/$target" "corpus/$target" -max_total_time="$seconds" -rss_limit_mb=2048 \
    -timeout=10 -artifact_prefix="artifacts/$target/" -print_final_stats=1 >"logs/$target.log" 2>&1 ||
    { tail -n 20 "logs/$target.log"; exit 1; }
  grep -E "^(Done|stat::number_of_executed_units|stat::peak_rss_mb)" "logs/$target.log" | sed "s/^/$target: /"
done
