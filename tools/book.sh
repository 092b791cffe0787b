#!/usr/bin/env bash
# Builds the book of docs/ into target/book, with mdBook from crates.io.
#
#     tools/book.sh            # target/book/index.html
#     tools/book.sh --install  # only mdBook, into target/tools
#
# mdBook compiles once, some minutes on two processors. Links that leave docs/ lead to GitHub.
set -euo pipefail
cd "$(dirname "$0")/.."
version=0.5.4
mdbook=target/tools/bin/mdbook

if [ "$("$mdbook" --version 2>/dev/null || true)" != "mdbook v$version" ]; then
    # Without the features that watch files and serve pages. Not optimised: it compiles in half the
    # time.
    CARGO_PROFILE_DEV_DEBUG=0 CARGO_TARGET_DIR=target/tools/build nice cargo install --quiet --locked --force --debug \
        --root target/tools --no-default-features --features search "mdbook@$version"
    rm -rf target/tools/build
fi
[ "${1:-}" != --install ] || exit 0

source=target/book-source
rm -rf "$source" target/book
mkdir -p "$source"
cp -r book.toml docs "$source"
python3 - "$source" <<'PY'
import os, pathlib, re, sys

root = pathlib.Path(sys.argv[1])
site = "https://github.com/joulebus/joulebus/blob/main/"
for page in root.glob("docs/**/*.md"):
    def outside(link):
        path = os.path.normpath(page.relative_to(root).parent / link[2])
        return link[0] if path.startswith("docs") else f"{link[1]}{site}{path}"
    text = page.read_text()
    page.write_text(re.sub(r"(\]\()((?:\.\./)+[^)\s#]+)", outside, text))
PY
"$mdbook" build --dest-dir "$PWD/target/book" "$source"
rm -rf "$source"
for page in index.html tutorial/rust.html reference/programs.html; do
    [ -s "target/book/$page" ] || { echo "book: target/book/$page is missing" >&2; exit 1; }
done
echo "book: $(find target/book -name '*.html' | wc -l) pages in target/book"
