# Sourced by lpvguard, demo and test: installs what is missing. Needs $root (the checkout); says what it does on stderr.
# shellcheck shell=bash

# A caller's PYTHONPATH would put another lpvguard before this checkout's.
unset PYTHONPATH PYTHONHOME
venv=$root/.venv
packages_run="g++ libeigen3-dev libtomlplusplus-dev pkg-config python3 python3-venv"
packages_test="can-utils catch2 clang cmake cppcheck g++-powerpc-linux-gnu gcc-powerpc-linux-gnu iproute2 libc6-dev-powerpc-cross libclang-rt-14-dev liblcm-bin liblcm-dev
  gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib ninja-build qemu-system-arm qemu-user user-mode-linux"

say() { printf '%s\n' "$*" >&2; }

# ensure_packages NAME...: Debian packages; without rights to install, one line says what to install, exit 2.
ensure_packages() {
  local missing=() package
  for package in "$@"; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
  done
  [ ${#missing[@]} -gt 0 ] || return 0
  local as_root=()
  if [ "$(id -u)" != 0 ]; then
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root=(sudo -n)
    else say "lpvguard: please install: apt-get install ${missing[*]}"; exit 2; fi
  fi
  say "installing ${missing[*]}"
  local log; log=$(mktemp)
  if ! { "${as_root[@]}" apt-get update && "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
         apt-get install -y --no-install-recommends "${missing[@]}"; } >"$log" 2>&1; then
    tail -n 20 "$log" >&2
    say "lpvguard: please install: apt-get install ${missing[*]}"
    exit 2
  fi
  rm -f "$log"
}

# ensure_venv EXTRA: the private environment with the package (and its extra: run or test), made anew when stale.
ensure_venv() {
  local extra=$1 wanted stamp
  wanted=$(cat "$root/tools/pyproject.toml" "$root/tools/constraints.txt" | sha256sum | cut -d' ' -f1)
  stamp=$venv/.lpvguard-$extra
  [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ] && return 0
  local python=python3.11
  command -v "$python" >/dev/null || python=python3
  [ -x /usr/bin/python3 ] && /usr/bin/python3 -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null &&
    python=/usr/bin/python3
  if ! "$python" -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    say "lpvguard: please install: apt-get install python3-venv (Python 3.11 or newer)"; exit 2
  fi
  say "setting up the private environment in ${venv#"$root"/} ($extra)"
  [ -x "$venv/bin/python" ] || "$python" -m venv "$venv" || exit 2
  local target=$root/tools
  [ "$extra" = run ] || target="$root/tools[$extra]"
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c "$root/tools/constraints.txt" -e "$target" || {
    say "lpvguard: the private environment could not be set up (pip failed, see above)"; exit 2; }
  printf '%s\n' "$wanted" | tee "$stamp" >"$venv/.lpvguard-run"   # every extra includes what running needs
}

# measured_data: the folder of measured drives, or nothing.
measured_data() {
  local folder=${LPVGUARD_DATA:-$root/../shared/data}
  [ -f "$folder/genesis_g80/experiments.csv" ] && (cd "$folder" && pwd)
}
