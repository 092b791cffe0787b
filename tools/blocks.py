#!/usr/bin/env python3
"""Runs the fenced blocks of README.md, the tutorials and the how-to pages, page by page, as a reader would.

    tools/blocks.py --programs target/debug                    # all pages
    tools/blocks.py --programs target/debug docs/how-to/ask.md # these pages
    tools/blocks.py --list                                     # the blocks that do not run, and why

Each page gets a copy of the clone that it may change, an empty home, an empty /dev/shm and a network of its own, which has
only this host: Linux namespaces give them, and end what still runs. So the commands run as they stand, with their ports.

| block | what is done |
|---|---|
| sh | runs. Commands of joulebus that do not end by themselves run until the page ends, and must end well then |
| console | `$ command` runs. The words of the other lines must be in what was printed, numbers apart |
| python | runs, all blocks of a page in one interpreter (JOULEBUS_PYTHON, or target/python, with the package) |
| toml | is put into the shipped file that has its section, and checked |
| c, cpp | compiles against the headers |
| rust | a whole program: is built as a project with the [dependencies] above it, and runs beside a worker |
| json | is read |

tools/blocks.toml changes that for the block of a page that `begins` so:

| key | meaning |
|---|---|
| not_run | it cannot run here, or another program runs it: the reason, which is printed |
| before | lines in the block's language that run first: what the page takes for granted |
| ends_with | the exit code that the page promises, or that prepared data give |
| prints | what a Rust program prints once it works |
| needs | programs without which the block is skipped aloud. With CI=true that is a failure |

What pages take for granted in common is in PREPARED. Where there are no namespaces, nothing runs, and that is said.
"""
import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK_S, PATIENCE_S = 600, 60
NAMESPACES = ["unshare", "--mount", "--net", "--pid", "--fork", "--kill-child", "--mount-proc"]
# Without root. Where this is not allowed, root can do without.
USER = ["--user", "--map-root-user"]
BLOCK = re.compile(r"^```([^\n`]*)\n([\s\S]*?)^```$", re.MULTILINE)
GIVEN = tomllib.loads((ROOT / "tools/blocks.toml").read_text())
# Projects of the Rust programs of pages.
PROJECTS = ROOT / "target/blocks"
# Where a program without [dependencies] on its page has them.
DEPENDENCIES = "docs/how-to/ask.md"
# What a page takes for granted if its text names it: how it is made.
PREPARED = {
    r"\bsimulated/": "joulebus data simulate simulated --steps 1500",
    r"\brecordings/": "joulebus data simulate recordings --steps 1500",
    r"\bt1\.csv\.gz": "joulebus data convert recordings/energy_data_trial1_structured.npy --out recordings/t1.csv.gz",
    r"\bhusky/": "joulebus data simulate made --steps 1500; mkdir husky\n"
    "n=0; for trial in made/*_trial*; do n=$((n + 1)); cp $trial husky/$([ $n -lt 3 ] && echo ICE || echo grass)-$n.npy; done",
    r"\blogs\b": "tools/walks/logs.sh logs",
    # A busy machine loses ticks now and then, and alarms then ends with 3.
    r"\brun\.mcap|fleet\.mcap|runs/": "until rm -f run.mcap; joulebus demo --duration 12 --plain --capture run.mcap\n"
    "joulebus alarms run.mcap; do :; done\n"
    "cp run.mcap fleet.mcap; mkdir runs; cp run.mcap runs/1.mcap",
    r"\bmy\.safetensors": "cp configs/models/gternal-sim.safetensors my.safetensors",
    r"\b(p|out)\.csv\b": "printf 'x_m,y_m,speed_mps\\n0,0,0.2\\n1,0,0.2\\n' | tee p.csv >out.csv",
    r"/etc/joulebus\b": "mkdir -p /etc/joulebus; cp configs/fleet.toml /etc/joulebus/lab.toml\n"
    "cp -r configs/platforms configs/models /etc/joulebus",
}
# Shell functions around the block: commands that last run beside it, and are waited for until they
# say something.
SHELL = r"""
set -euo pipefail
lasting() {
    # A reader does not start again what runs already.
    ! grep -qsxF "$*" "$LASTING"/*.command || return 0
    local name
    name=$(mktemp "$LASTING/XXXXXX")
    printf '%s\n' "$*" >"$name.command"
    (set +e; "$@" >"$name.log" 2>&1 </dev/null 3>&- & echo $! >"$name.pid"; wait $!; echo $? >"$name.ended") >/dev/null 2>&1 3>&- &
    local end=$((SECONDS + 30))
    [ -n "$ready" ] || end=$((SECONDS + 2))
    until [ -s "$name.ended" ] || [ $SECONDS -ge $end ] || grep -qsE "${ready:-^never$}" "$name.log"; do sleep 0.05; done
    sleep 0.3
    [ ! -s "$name.ended" ] || { cat "$name.log"; return "$(cat "$name.ended")"; }
}
# A reader ends a worker, a bridge and a page before another one with other options.
replaced() {
    local command
    for command in $(grep -lse "^env joulebus $1 " "$LASTING"/*.command); do
        ! grep -qxF "env joulebus $*" "$command" || continue
        [ -s "${command%.command}.ended" ] || kill "$(cat "${command%.command}.pid")"
        until [ -s "${command%.command}.ended" ]; do sleep 0.05; done
    done
}
joulebus() {
    local ready=.
    case " $* " in
        *' --check '* | *' --write '* | *' --once '* | *' --duration '* | *' --explain '* | *' --acknowledge '* | *' --help '* | *' alarms '*.mcap*) ;;
        ' run '*) ready='ready|stand' ;;&
        ' run '* | ' serve '* | ' bridge '*) replaced "$@" ;;&
        ' run '* | ' serve '* | ' bridge '* | ' link '* | ' watch '* | ' alarms '*) lasting env joulebus "$@"; return ;;
        ' record '* | ' publish '*) ready='' lasting env joulebus "$@"; return ;;
    esac
    command joulebus "$@"
}
# As nobody but root is here, it cannot become another user.
mosquitto() {
    printf 'user root\nallow_anonymous true\n' >"$LASTING/mosquitto.conf"
    ready=running lasting env mosquitto -c "$LASTING/mosquitto.conf" "$@"
}
mosquitto_sub() { ready=. lasting env mosquitto_sub "$@"; }
prometheus() { ready='ready to receive' lasting env prometheus "$@"; }
"""
# A section or key of a TOML block: the shipped file that has it, and how the whole is checked.
WHOLE = {
    "battery": ("configs/platforms/gternal.toml", "joulebus config check configs/fleet.toml"),
    "model": ("configs/platforms/gternal.toml", "joulebus config check configs/fleet.toml"),
    "webhook": ("configs/webhooks/receivers.toml", "joulebus config check configs/webhooks/receivers.toml"),
    "workers": ("configs/links/standby.toml", "joulebus link configs/links/standby.toml --check"),
}


@dataclass
class Block:
    """A fenced block of a page."""

    page: str
    line: int
    language: str
    text: str
    given: dict

    def not_run(self):
        return self.given.get("not_run")

    def project(self):
        """Name of the project of a Rust program."""
        return re.sub(r"\W+", "-", f"{self.page}-{self.line}").lower()


def blocks(page):
    """All fenced blocks of a page with a language, in order."""
    text = (ROOT / page).read_text()
    if re.search(r"^<!--", text, re.MULTILINE):
        raise SystemExit(f"{page} has a comment: what it says about a block belongs into tools/blocks.toml")
    found = [Block(page, text.count("\n", 0, one.start()) + 1, one[1], one[2], {}) for one in BLOCK.finditer(text) if one[1]]
    for given in GIVEN.get(page, []):
        meant = [block for block in found if block.text.startswith(given["begins"])]
        if len(meant) != 1:
            raise SystemExit(f"tools/blocks.toml: {len(meant)} blocks of {page} begin with {given['begins']!r}, and not one")
        meant[0].given = given
    return found


def pages():
    return ["README.md", *(str(path.relative_to(ROOT)) for at in ("tutorial", "how-to") for path in sorted((ROOT / "docs" / at).glob("*.md")))]


def wanted(line):
    """A pattern for a printed line of a page: its words, with any number for a number and anything for an ellipsis."""
    words = " ".join(line.split())
    parts = re.split(r"(-?\d[\d.,]*|…)", words)
    return "".join(re.escape(part) if at % 2 == 0 else ".*?" if part == "…" else r"-?\d[\d.,]*" for at, part in enumerate(parts))


class Page:
    """A page in its namespaces."""

    def __init__(self, scratch, programs):
        self.scratch, self.here = scratch, scratch / "joulebus"
        self.printed, self.interpreter = "", None
        self.lasting = scratch / "lasting"
        mounted(scratch, programs)
        self.environment = os.environ | {
            "USER": "ann", "HOME": str(scratch / "home"), "LASTING": str(self.lasting), "PYTHONUNBUFFERED": "1",
            "PYTHONPATH": os.environ.get("PYTHONPATH") or str(ROOT / "target/python-package"),
            "PATH": f"{scratch}/bin:{scratch}/programs:{os.environ['PATH']}",
        }
        for name in [name for name in self.environment if name.startswith("XDG_")]:
            del self.environment[name]

    def shell(self, text, allowed=0):
        """Runs a block. Returns an error, or nothing."""
        # A command that lasts is put into the background anyway.
        text = re.sub(r"^((?:joulebus|mosquitto)\b.*?) *&$", r"\1", text, flags=re.MULTILINE)
        whole = f'{SHELL}cd "$(cat "$LASTING.folder")"\ntrap \'pwd >"$LASTING.folder"\' EXIT\n{text}'
        log = self.scratch / "block.log"
        with open(log, "wb") as output:
            try:
                ended = subprocess.run(["bash", "-c", whole], stdout=output, stderr=output, stdin=subprocess.DEVNULL,
                                       cwd=self.here, env=self.environment, timeout=BLOCK_S).returncode
            except subprocess.TimeoutExpired:
                ended = f"no end within {BLOCK_S} s"
        self.printed = log.read_text(errors="replace")
        if ended != allowed:
            return f"ends with {ended}, {allowed} is expected\n{self.printed[-3000:]}"
        return self.endings(ended_well=True)

    def endings(self, ended_well):
        """What went wrong with commands that last."""
        for ended in self.lasting.glob("*.ended"):
            code, command = int(ended.read_text() or 0), ended.with_suffix(".command").read_text().strip()
            # Three: data was lost, as when nobody answers an example's address.
            if code not in ((0, 3) if ended_well else (0, 3, -signal.SIGTERM, 128 + signal.SIGTERM)):
                return f"{command}: ends with {code}\n{ended.with_suffix('.log').read_text(errors='replace')[-3000:]}"
        return None

    def console(self, block):
        text = block.text
        lines = text.split("\n")
        command = [line[2:] for line in lines if line.startswith("$ ")]
        wrong = self.shell(block.given.get("before", "") + "\n" + "\n".join(command), block.given.get("ends_with", 0)) if command else None
        end = time.monotonic() + PATIENCE_S
        while not wrong:
            logs = [log.read_text(errors="replace") for log in self.lasting.glob("*.log")]
            said = " ".join(" ".join([self.printed, *logs]).split())
            missing = [line for line in lines if line.strip() and not line.startswith("$ ") and not re.search(wanted(line), said)]
            if not missing:
                return None
            if not logs or time.monotonic() > end:
                return f"not printed: {missing}\n{self.printed[-3000:]}"
            time.sleep(0.2)
        return wrong

    def python(self, block):
        if self.interpreter is None:
            program = "import sys, traceback, builtins\nnames = {'__name__': 'block'}\n" \
                "for line in sys.stdin:\n" \
                "    try: exec(compile(eval(line), 'block', 'exec'), names); print('DONE', flush=True)\n" \
                "    except BaseException: traceback.print_exc(file=sys.stdout); print('FAILED', flush=True)\n"
            self.interpreter = subprocess.Popen([shutil.which("python", path=self.environment["PATH"]), "-P", "-c", program], text=True,
                                                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=self.here, env=self.environment)
        self.interpreter.stdin.write(repr(block.given.get("before", "") + "\n" + block.text) + "\n")
        self.interpreter.stdin.flush()
        self.printed = ""
        for line in self.interpreter.stdout:
            if line in ("DONE\n", "FAILED\n"):
                return None if line == "DONE\n" else self.printed[-3000:]
            self.printed += line
        return f"Python has ended\n{self.printed[-3000:]}"

    def rust(self, block):
        """Runs a program until it ends well. One that goes on stays beside the next blocks."""
        program, prints = ROOT / "target/debug" / block.project(), block.given.get("prints", "")
        # Two sources of the same robots exclude each other.
        ended = "replaced publish none\n" if "Publisher::connect" in block.text else ""
        return self.shell(f"""joulebus run --config configs/fleet.toml
{ended}{block.given.get("before", "")}
code=1
for _ in $(seq {PATIENCE_S}); do
    code=0
    timeout 3 {program} >said 2>&1 || code=$?
    [ $code != 0 ] && [ $code != 124 ] || break
done
cat said
[ $code != 124 ] || {{ code=0; ready='{prints}' lasting {program}; }}
[ -z '{prints}' ] || grep -qsE '{prints}' said "$LASTING"/*.log || {{ echo 'not printed: {prints}'; exit 1; }}
exit $code""")

    def toml(self, block):
        key = re.search(r"^\[*([a-z_]+)", block.text, re.MULTILINE)[1]
        if key == "dependencies":
            return None  # A project is built with them.
        file, check = WHOLE[key]
        path = self.here / file
        before = path.read_text()
        if re.search(r"^\[", block.text, re.MULTILINE):
            # Its sections take the place of those of the same names.
            sections = re.findall(r"^\[[^\n]*", block.text, re.MULTILINE)
            kept = [part for part in re.split(r"(?=^\[)", before, flags=re.MULTILINE) if part.split("\n")[0].split("#")[0].strip() not in
                    [section.split("#")[0].strip() for section in sections]]
            path.write_text("".join(kept) + "\n" + block.text)
        else:
            path.write_text(re.sub(rf"^{key} = [^\n]*\n", lambda _: block.text, before, count=1, flags=re.MULTILINE))
        return self.shell(block.given.get("before", "") + "\n" + check)

    def compiled(self, block, compiler, suffix):
        text = block.text
        if "main(" not in text:
            text = ("#include <chrono>\n#include <iostream>\n#include <joulebus.hpp>\n#include <thread>\n#include <vector>\nint main() {\n"
                    f"{block.given.get('before', '')}\n{text}}}\n")
        source = self.scratch / f"block{suffix}"
        source.write_text(text)
        done = subprocess.run([*compiler, "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-Wno-unused", f"-I{ROOT}/crates/languages/c/include", source],
                              capture_output=True, text=True)
        return done.stderr[:3000] if done.returncode else None

    def lacks(self, block):
        """What is missing here that this block needs."""
        needed = block.given.get("needs", "").split()
        needed += {"c": ["cc"], "cpp": ["c++"]}.get(block.language, [])
        missing = [name for name in needed if not shutil.which(name, path=self.environment["PATH"])]
        if block.language == "python" and subprocess.run(["python", "-P", "-c", "import joulebus"], env=self.environment, capture_output=True).returncode:
            missing.append("the package (tools/python_package.sh --workspace)")
        return missing

    def run(self, block):
        match block.language:
            case "sh":
                return self.shell(block.given.get("before", "") + "\n" + block.text, block.given.get("ends_with", 0))
            case "console":
                return self.console(block)
            case "python":
                return self.python(block)
            case "toml":
                return self.toml(block)
            case "c":
                return self.compiled(block, ["cc", "-std=gnu11"], ".c")
            case "cpp":
                return self.compiled(block, ["c++", "-std=c++17"], ".cpp")
            case "rust,no_run":
                return self.rust(block)
            case "json":
                json.loads(block.text)
                return None
        return f"nothing runs blocks of {block.language}: give a reason, `not_run` in tools/blocks.toml"

    def close(self):
        """Ends what lasts. Returns what went wrong."""
        running = [path for path in self.lasting.glob("*.pid") if not path.with_suffix(".ended").exists()]
        # Those that started last end first: sources before the worker, as a reader would.
        for path in sorted(running, key=lambda path: path.stat().st_mtime, reverse=True):
            os.kill(int(path.read_text()), signal.SIGTERM)
            end = time.monotonic() + PATIENCE_S
            while not path.with_suffix(".ended").exists() or not path.with_suffix(".ended").read_text():
                if time.monotonic() > end:
                    return f"{path.with_suffix('.command').read_text().strip()}: does not end within {PATIENCE_S} s of SIGTERM"
                time.sleep(0.05)
        return self.endings(ended_well=False)


def mounted(scratch, programs):
    """Lays out what the page sees, only inside its namespaces."""
    subprocess.run(["ip", "link", "set", "lo", "up", "multicast", "on"], check=True)
    subprocess.run(["ip", "route", "add", "224.0.0.0/4", "dev", "lo"], check=True)
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/dev/shm"], check=True)
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/run"], check=True)
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", scratch], check=True)
    for name in ("joulebus", "home", "bin", "programs", "lasting", "changes", "changing", "etc", "etcing"):
        (scratch / name).mkdir()
    for place, lower, upper, work in ((scratch / "joulebus", ROOT, "changes", "changing"), (Path("/etc"), "/etc", "etc", "etcing")):
        options = f"lowerdir={lower},upperdir={scratch}/{upper},workdir={scratch}/{work},userxattr"
        subprocess.run(["mount", "-t", "overlay", "overlay", "-o", options, place], check=True)
    for place in ("programs", "joulebus/target/release", "joulebus/target/debug"):
        (scratch / place).mkdir(parents=True, exist_ok=True)
        subprocess.run(["mount", "--bind", programs, scratch / place], check=True)
    python = os.environ.get("JOULEBUS_PYTHON") or ROOT / "target/python/bin/python"
    for name in ("python", "python3"):
        # Not a link: an environment is found by the path of its program.
        (scratch / "bin" / name).write_text(f'#!/bin/sh\nexec {python} "$@"\n')
        (scratch / "bin" / name).chmod(0o755)
    (scratch / "lasting.folder").write_text(str(scratch / "joulebus"))


def inside(name, programs, scratch):
    """One page, in its namespaces: prints what fails and returns how many blocks did."""
    found = [block for block in blocks(name) if not block.not_run()]
    page = Page(Path(scratch), programs)
    text = "\n".join(block.text + block.given.get("before", "") for block in found)
    failed = 0
    for pattern, recipe in PREPARED.items():
        if re.search(pattern, text):
            wrong = page.shell(recipe)
            assert not wrong, f"{recipe}: {wrong}"
    for block in found:
        begun = time.monotonic()
        if missing := page.lacks(block):
            print(f"blocks: skipped: {block.page}:{block.line}: {', '.join(missing)} is missing")
            failed += os.environ.get("CI") == "true"
            continue
        wrong = page.run(block)
        if os.environ.get("BLOCKS_VERBOSE"):
            print(f"--- {block.page}:{block.line} {block.language}, {time.monotonic() - begun:.1f} s\n{page.printed}")
        if wrong:
            failed += 1
            print(f"{block.page}:{block.line}: {block.language}: {wrong}")
    if wrong := page.close():
        failed += 1
        print(f"{name}: {wrong}")
    if os.environ.get("BLOCKS_VERBOSE"):
        for log in page.lasting.glob("*.log"):
            print("---", log.with_suffix(".command").read_text().strip(), "\n", log.read_text(errors="replace")[-1500:])
    return failed


def build(names):
    """Builds the Rust programs of these pages, each as a project of its own. Returns whether that failed."""
    found = [(block, here[:place]) for name in names for here in [blocks(name)] for place, block in enumerate(here)
             if block.language == "rust,no_run" and not block.not_run()]
    if not found:
        return False
    is_needed = lambda block: block.text.startswith("[dependencies]\n")
    shutil.rmtree(PROJECTS, ignore_errors=True)
    for block, before in found:
        needed = [of for of in before if is_needed(of)] or list(filter(is_needed, blocks(DEPENDENCIES)))
        project = PROJECTS / block.project()
        (project / "src").mkdir(parents=True)
        # The clone lies beside a reader's project. Here programs run in it.
        (project / "src/main.rs").write_text(block.text.replace("../joulebus/", ""))
        manifest = f'[package]\nname = "{block.project()}"\nedition = "2024"\n\n{needed[-1].text}'
        (project / "Cargo.toml").write_text(manifest.replace("../joulebus/", f"{ROOT}/"))
    # One workspace, with our profile and versions, so that existing builds are reused.
    ours = (ROOT / "Cargo.toml").read_text()
    profile = "\n".join(re.findall(r'(?m)^\[profile\.dev(?:\.package\."\*")?\]\n(?:\w.*\n)*', ours))
    (PROJECTS / "Cargo.toml").write_text(f'[workspace]\nresolver = "3"\nmembers = ["*"]\n\n{profile}')
    shutil.copy(ROOT / "Cargo.lock", PROJECTS)
    print(f"{len(found)} programs in Rust, each a project of its own", flush=True)
    command = ["cargo", "build", "--quiet", "--offline", "--target-dir", ROOT / "target"]
    return subprocess.run(command, cwd=PROJECTS).returncode != 0


def run(names, programs):
    """Runs these pages. Returns how many failed."""
    if build(names):
        return 1
    programs = Path(programs).resolve()
    tried = [subprocess.run([*NAMESPACES, *user, "true"], capture_output=True, text=True) for user in (USER, []) if shutil.which("unshare")]
    possible = next((one.args[:-1] for one in tried if one.returncode == 0), None)
    if possible is None:
        # No package gives them: a container forbids them, or the kernel has none.
        print(f"SKIPPED: blocks: no namespaces here ({tried[0].stderr.strip() if tried else 'no unshare'})", file=sys.stderr)
        return 0
    failed = done = 0
    for name in names:
        here = [block for block in blocks(name) if not block.not_run()]
        if not here:
            continue
        begun = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="jb") as scratch:
            ended = subprocess.run([*possible, sys.executable, __file__, "--programs", programs, "--inside", scratch, name])
        failed += ended.returncode != 0
        done += len(here)
        print(f"{time.monotonic() - begun:6.1f} s  {len(here):2} blocks  {name}{'  FAILED' if ended.returncode else ''}", flush=True)
    print(f"{done} blocks ran on {len(names)} pages; {failed or 'no'} pages failed")
    return failed


def excused(names):
    """Prints the blocks that do not run, with reasons. Returns how many are no valid shell."""
    found = [block for name in names for block in blocks(name)]
    left = [block for block in found if block.not_run()]
    wrong = 0
    for block in left:
        print(f"not run: {block.page}:{block.line}: {block.language}: {' '.join(block.not_run().split())}")
        if block.language == "sh":
            wrong += subprocess.run(["bash", "-n", "-c", block.text]).returncode != 0
    print(f"{len(left)} of {len(found)} blocks are not run here")
    return wrong


def main():
    if strange := sorted(set(GIVEN) - set(pages())):
        raise SystemExit(f"tools/blocks.toml: there are no such pages: {strange}")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", default=ROOT / "target/debug", help="the folder of joulebus and its other programs")
    parser.add_argument("--list", action="store_true", help="only the blocks that do not run")
    parser.add_argument("--inside", help=argparse.SUPPRESS)
    parser.add_argument("pages", nargs="*", default=pages())
    options = parser.parse_args()
    if options.inside:
        return inside(options.pages[0], options.programs, options.inside)
    wrong = excused(options.pages)
    return bool(wrong if options.list else run(options.pages, options.programs) or wrong)


if __name__ == "__main__":
    sys.exit(main())
