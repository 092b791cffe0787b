#!/usr/bin/env bash
# Builds all programs of joulebus from these sources, and installs them with their manual pages and
# completions.
#
#     tools/install.sh                              # below ~/.local
#     tools/install.sh /usr/local                   # below another prefix
#     tools/install.sh PREFIX --from target/debug   # of programs that are built already
#
# The C library has tools/install_c.sh, Python `pip install ./crates/languages/python`, services the
# Debian package of
# tools/deb.sh.
set -euo pipefail
cd "$(dirname "$0")/.."
fail() { echo "tools/install.sh: $1" >&2; exit "${2:-1}"; }

prefix='' from=''
while [ $# -gt 0 ]; do
    case $1 in
        --from) from=$(realpath -- "${2?--from needs the folder of the programs}") && shift 2 ;;
        -* | '') sed -n '2,/^set/s/^# \?//p' "$0" >&2; exit 2 ;;
        *) [ -z "$prefix" ] || fail "one prefix, not also $1" 2
            prefix=$1 && shift ;;
    esac
done
prefix=$(realpath -m -- "${prefix:-$HOME/.local}")
mapfile -t programs < <(tools/programs.sh)

begun=$SECONDS
mkdir -p "$prefix/bin" 2>/dev/null && [ -w "$prefix/bin" ] || fail "$prefix/bin cannot be written to: name another prefix, or be root"
if [ -z "$from" ]; then
    command -v cargo >/dev/null || fail 'there is no cargo: install Rust by https://rustup.rs'
    command -v cc >/dev/null || fail 'there is no cc: install a C compiler (Debian: apt-get install gcc libc6-dev)'
    echo "Building ${programs[*]}: about a quarter of an hour on two cores, and 2 GB in target/. What was built before is not built again." >&2
    options=()
    for program in "${programs[@]}"; do options+=(-p "$program"); done
    cargo build --locked --release --bins "${options[@]}"
    from=${CARGO_TARGET_DIR:-target}/release
fi
for program in "${programs[@]}"; do
    [ -x "$from/$program" ] || fail "$from has no $program: cargo build -p $program"
    install -m 755 "$from/$program" "$prefix/bin/$program"
done
joulebus=$prefix/bin/joulebus share=$prefix/share
"$joulebus" man "$share/man/man1"
install -d "$share"/{bash-completion/completions,fish/vendor_completions.d,zsh/site-functions}
"$joulebus" completions bash >"$share/bash-completion/completions/joulebus"
"$joulebus" completions fish >"$share/fish/vendor_completions.d/joulebus.fish"
"$joulebus" completions zsh >"$share/zsh/site-functions/_joulebus"

echo "$("$joulebus" --version): ${#programs[@]} programs in $prefix/bin, manual pages and completions in $share, after $((SECONDS - begun)) s"
if [ "$(command -v joulebus || true)" = "$joulebus" ]; then
    echo 'Next: joulebus'
else
    echo "Next: export PATH=$(printf %q "$prefix/bin"):\$PATH; joulebus"
fi
