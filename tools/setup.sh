# Sourced by lpvguard, demo and test: installs what is missing. Needs $root (the checkout) and set -euo pipefail; says what it does on stderr.
# shellcheck shell=bash

# A caller's PYTHONPATH would put another lpvguard before this checkout's.
unset PYTHONPATH PYTHONHOME
venv=$root/.venv

# Debian packages. tests/tools/test_packages.py holds the lists against what the build and the tests ask for.
packages_run="g++ libeigen3-dev libtomlplusplus-dev pkg-config python3 python3-venv"
packages_test="catch2 cmake git ninja-build"
# Optional parts: without one, its tests are counted as skipped. LPVGUARD_WITHOUT="lcm qemu" leaves parts out on purpose.
optional_parts="chromium clang llvm19 cppcheck powerpc lcm qemu uml"
packages_chromium="chromium fonts-dejavu-core"   # opens the report page
packages_clang="clang libclang-rt-dev"   # libclang-rt-dev: of the version that clang depends on (clang_runtime)
packages_llvm19="clang-19 clang-tidy-19 libclang-rt-19-dev llvm-19"   # MC/DC and clang-tidy: of one version, for its checks and their names
packages_cppcheck="cppcheck"
packages_powerpc="g++-powerpc-linux-gnu gcc-powerpc-linux-gnu libc6-dev-powerpc-cross qemu-user"
packages_lcm="libglib2.0-dev liblcm-bin liblcm-dev"
packages_qemu="gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib qemu-system-arm"
packages_uml="can-utils iproute2 user-mode-linux"

say() { printf '%s\n' "$*" >&2; }

# usage_of SCRIPT: the comment at its head.
usage_of() { sed -n '2,/^[^#]/s/^#\( \|$\)//p' "$1"; }

# help_or_refuse SCRIPT ARGUMENT...: for arguments that the script does not take: its usage and exit 0 for --help, exit 2 for others.
help_or_refuse() {
  local script=$1
  shift
  if [ "$*" = --help ] || [ "$*" = -h ]; then usage_of "$script"; exit 0; fi
  say "$(basename "$script"): unknown arguments: $*"
  usage_of "$script" >&2
  exit 2
}

# clang_runtime: the package of the sanitizers of the release's clang, whose name holds the version.
clang_runtime() {
  local depends
  depends=$(dpkg-query -W -f='${Depends}' clang 2>/dev/null) || true
  [ -n "$depends" ] || depends=$(apt-cache show --no-all-versions clang 2>/dev/null | sed -n 's/^Depends: //p') || true
  if [[ $depends =~ clang-([0-9]+) ]]; then echo "libclang-rt-${BASH_REMATCH[1]}-dev"; fi
}

# packages_of GROUP...: names, one a line.
packages_of() {
  local group list name
  for group in "$@"; do
    list=packages_$group
    for name in ${!list}; do
      if [ "$name" = libclang-rt-dev ]; then clang_runtime; else echo "$name"; fi
    done
  done
}

# missing_of GROUP...: those that are not installed, one a line.
missing_of() {
  local names
  mapfile -t names < <(packages_of "$@")
  { dpkg-query -W -f='${db:Status-Status} ${Package}\n' "${names[@]}" 2>/dev/null || true; } | sed -n 's/^installed //p' |
    { grep -vxF -f - <(printf '%s\n' "${names[@]}") || true; }
}

# apt_progress LOG NAME...: apt's report from stdin into LOG; on stderr each quarter of the download and each NAME that is unpacked.
apt_progress() {
  local log=$1 line percent name quarter=0 count=0 names
  shift
  names=" $* "
  while IFS= read -r line; do
    case $line in
      dlstatus:*)
        percent=${line#dlstatus:*:}
        percent=${percent%%[.:]*}
        if [ $((percent / 25)) -gt "$quarter" ]; then
          quarter=$((percent / 25))
          say "  downloaded $((quarter * 25)) %"
        fi ;;
      pmstatus:*:Unpacking\ *)
        name=${line##*:Unpacking }
        name=${name%% *}
        if [[ $names == *" ${name%:*} "* ]]; then
          count=$((count + 1))
          say "  installing $count of $#: $name"
        fi ;;
      pmstatus:*) ;;
      *) printf '%s\n' "$line" >>"$log" ;;
    esac
  done
}

# apt_install NAME...: by apt, with progress; the end of its log and its status when it fails.
apt_install() {
  local log status=0
  log=$(mktemp)
  # Not APT::Status-Fd=1: apt closes that descriptor for the packages' scripts, and one that prints then fails. sudo closes 3, hence sh.
  # shellcheck disable=SC2016
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
    sh -c 'exec apt-get install -y --no-install-recommends -o APT::Status-Fd=3 -o Dpkg::Use-Pty=0 "$@" 3>&1' apt-get "$@" </dev/null 2>&1 |
    apt_progress "$log" "$@" || status=$?
  [ "$status" = 0 ] || tail -n 20 "$log" >&2
  rm -f "$log"
  return "$status"
}

# become_root: sets as_root, the words in front of a command that needs root; fails where there are none.
become_root() {
  as_root=()
  [ "$(id -u)" != 0 ] || return 0
  as_root=(sudo -n)
  command -v sudo >/dev/null && sudo -n true 2>/dev/null
}

# ensure_packages GROUP...: the required groups, exit 2 when they cannot be had; with the group test the optional parts too, of which one
# that cannot be had is named once and left out.
ensure_packages() {
  local parts="" offered="" part log required names have_apt=1
  if [[ " $* " == *" test "* ]]; then
    for part in $optional_parts; do
      if [[ " ${LPVGUARD_WITHOUT:-} " == *" $part "* ]]; then say "without $part (LPVGUARD_WITHOUT): its tests are counted as skipped"
      else parts+=" $part"; fi
    done
  fi
  if ! command -v dpkg-query >/dev/null; then
    say "no dpkg here, so nothing is installed; what is needed, by Debian's names: $(packages_of "$@" | tr '\n' ' ')"
    return 0
  fi
  # shellcheck disable=SC2086
  [ -n "$(missing_of "$@" $parts)" ] || return 0
  { command -v apt-get >/dev/null && become_root; } || have_apt=0
  if [ "$have_apt" = 1 ]; then
    say "reading the package lists"
    log=$(mktemp)
    "${as_root[@]}" apt-get update >"$log" 2>&1 || { tail -n 20 "$log" >&2; say "apt-get update failed: going on with the lists of before"; }
    rm -f "$log"
    mapfile -t required < <(missing_of "$@")
    names=("${required[@]}")
    for part in $parts; do
      # A part of which the release lacks a package would fail the whole request.
      # shellcheck disable=SC2046
      if apt-cache show $(packages_of "$part") >/dev/null 2>&1; then
        offered+=" $part"
        mapfile -t -O ${#names[@]} names < <(missing_of "$part")
      fi
    done
    if [ ${#names[@]} -gt 0 ]; then
      say "installing ${#names[@]} packages and what they need: ${names[*]}"
      if ! apt_install "${names[@]}" && [ -n "$parts" ]; then
        say "not in one go: the required packages first, then part by part"
        [ ${#required[@]} = 0 ] || apt_install "${required[@]}" || true
        for part in $offered; do
          mapfile -t names < <(missing_of "$part")
          [ ${#names[@]} = 0 ] || apt_install "${names[@]}" || true
        done
      fi
    fi
  fi
  mapfile -t required < <(missing_of "$@")
  if [ ${#required[@]} -gt 0 ]; then say "lpvguard: please install: apt-get install ${required[*]}"; exit 2; fi
  for part in $parts; do
    mapfile -t names < <(missing_of "$part")
    [ ${#names[@]} = 0 ] || say "without $part: its tests are counted as skipped; for them: apt-get install ${names[*]}"
  done
}

# find_python: sets python, an interpreter that can make the environment.
find_python() {
  for python in /usr/bin/python3 python3.11 python3; do
    ! "$python" -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || return 0
  done
  say "lpvguard: please install: apt-get install python3-venv (Python 3.11 or newer)"
  exit 2
}

# made_here: what the environment of this checkout and its interpreter says of itself. A copied or moved one would run the original's code.
made_here() { printf '%s\n' "$root" "$("$venv/bin/python" -V 2>&1)"; }
wanted_packages() { cat "$root/tools/pyproject.toml" "$root"/tools/locks/*.txt | sha256sum | cut -d' ' -f1; }

# venv_is_current EXTRA: made here, by the interpreter that still runs it, with the packages that are wanted.
venv_is_current() {
  [ -x "$venv/bin/lpvguard" ] && [ "$(cat "$venv/.lpvguard-made" 2>/dev/null)" = "$(made_here)" ] &&
    [ "$(cat "$venv/.lpvguard-$1" 2>/dev/null)" = "$(wanted_packages)" ]
}

# pip_install ARGUMENT...: a line each ten packages; the end of its log and its status when it fails.
pip_install() {
  local log line count=0 status=0
  log=$(mktemp)
  "$venv/bin/python" -m pip install --disable-pip-version-check --progress-bar off "$@" </dev/null 2>&1 |
    while IFS= read -r line; do
      printf '%s\n' "$line" >>"$log"
      case $line in
        Collecting\ *)
          count=$((count + 1))
          [ $((count % 10)) != 0 ] || say "  pip: $count packages fetched" ;;
        "Installing collected packages: "*) say "  pip: installing $(wc -w <<<"${line#*: }") packages" ;;
      esac
    done || status=$?
  [ "$status" = 0 ] || tail -n 20 "$log" >&2
  rm -f "$log"
  return "$status"
}

# pip_install_locked NAME: the pins of that name in tools/locks, where the files have the hashes that stand there.
pip_install_locked() { pip_install --require-hashes --only-binary :all: -r "$root/tools/locks/$1.txt"; }

# ensure_venv EXTRA: the private environment with the package (and its extra: run or test), made anew when it is not current.
ensure_venv() {
  local extra=$1
  ! venv_is_current "$extra" || return 0
  if [ "$(cat "$venv/.lpvguard-made" 2>/dev/null)" != "$(made_here 2>/dev/null)" ]; then
    if [ -e "$venv" ] && [ ! -e "$venv/.lpvguard-made" ] && [ ! -e "$venv/.lpvguard-run" ]; then
      say "lpvguard: $venv is there and not lpvguard's: remove it"; exit 2
    fi
    find_python
    [ ! -e "$venv" ] || say "the environment in $venv was made for another path or interpreter: making it anew"
    rm -rf "$venv"
    say "making the private environment in ${venv#"$root"/} ($("$python" -V))"
    mkdir "$venv" && touch "$venv/.lpvguard-made" && "$python" -m venv "$venv" || exit 2
    made_here >"$venv/.lpvguard-made"
  fi
  say "installing the Python package ($extra)"
  { pip_install_locked "$extra" && pip_install --no-deps --no-build-isolation -e "$root/tools"; } ||
    { say "lpvguard: the private environment could not be set up (pip failed, see above)"; exit 2; }
  if [ "$extra" = test ] && [[ " ${LPVGUARD_WITHOUT:-} " != *" lcm "* ]]; then
    pip_install_locked lcm || say "without the Python package lcm: its tests are counted as skipped"
  fi
  wanted_packages | tee "$venv/.lpvguard-$extra" >"$venv/.lpvguard-run"   # every extra includes what running needs
}

# drop_foreign_builds: removes CMake's builds of this project that were copied or moved here, or made from another checkout. CMake stops at
# them.
drop_foreign_builds() {
  local cache folder
  [ -d "$root/build" ] || return 0
  while IFS= read -r cache; do
    folder=${cache%/CMakeCache.txt}
    if [ -f "$cache" ] && grep -q '^CMAKE_PROJECT_NAME:STATIC=lpvguard' "$cache" &&
       { ! grep -qxF "CMAKE_CACHEFILE_DIR:INTERNAL=$folder" "$cache" ||
         { [ "$folder" = "$root/build" ] && ! grep -qxF "CMAKE_HOME_DIRECTORY:INTERNAL=$root" "$cache"; }; }; then
      say "${folder#"$root"/} is a build of another checkout: making it anew"
      rm -rf "$folder"
    fi
  done < <(find "$root/build" -name CMakeCache.txt | sort)
}

# measured_data: the folder of measured drives, or nothing.
measured_data() {
  local folder=${LPVGUARD_DATA:-$root/../shared/data}
  [ -f "$folder/genesis_g80/experiments.csv" ] && (cd "$folder" && pwd)
}
