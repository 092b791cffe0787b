#!/usr/bin/env python3
"""Writes the reference pages of the C and the Python API from the header and the package's documentation strings.

    tools/api_pages.py --check    # the gate: the pages say what the sources say
    tools/api_pages.py --write    # after a change of joulebus.h or of the Python package

docs/reference/c-functions.md has the functions, structs and enums of crates/languages/c/include/joulebus.h. The structs
of shared memory are in docs/reference/layout.md. docs/reference/python-classes.md has what `import joulebus` exports.
Only the part between the marks is written. Standard library only.
"""
import argparse
import ast
import difflib
import pathlib
import re
import sys
import textwrap

ROOT = pathlib.Path(__file__).resolve().parent.parent
HEADER = ROOT / "crates/languages/c/include/joulebus.h"
PACKAGE = ROOT / "crates/languages/python/python/joulebus"
NATIVE = ROOT / "crates/languages/python/src/energy_predictor.rs"
BEGIN, END = "<!-- api: written by tools/api_pages.py -->", "<!-- end of api -->"
# Classes of Python that only the package makes.
RESULTS = {"Analysis", "Answer", "Answers", "Demo", "Evaluation", "Figure", "Forecast", "Frame", "Report", "Simulation", "Table", "Training"}
# Functions of C by the object that they belong to. All others are of the library.
OBJECTS = ["publisher", "subscriber", "frame", "questions", "client", "predictor"]


def cell(text):
    return " ".join(text.split()).replace("|", "\\|").replace("<", "\\<")


def table(head, rows):
    return "\n".join(["| " + " | ".join(line) + " |" for line in (head, ["---"] * len(head), *rows)])


def paragraphs(text):
    return [textwrap.fill(" ".join(part.split()), 100, break_long_words=False, break_on_hyphens=False)
            for part in re.split(r"\n\s*\n", text) if part.strip()]


def comment(text):
    """The lines of a Doxygen comment, without its stars."""
    text = text.strip().removeprefix("/**").removesuffix("*/")
    return "\n".join(re.sub(r"^\s*\* ?", "", line) for line in text.splitlines()).strip()


def c_functions(text):
    """A heading, the prototype, the text and the parameters of each function."""
    found = {name: [] for name in ["", *OBJECTS]}
    for doc, prototype, name in re.findall(r"(/\*\*(?:(?!\*/)[\s\S])*\*/)\n((?:const )?\w+ \*?(joulebus_\w+)\([^;]*\);)", text):
        told, *tags = re.split(r"^@", comment(doc), flags=re.MULTILINE)
        parts = [f"### {name}", f"```c\n{prototype}\n```", *paragraphs(told)]
        parameters = [re.fullmatch(r"param (\w+)\s+([\s\S]*)", tag.strip()) for tag in tags if tag.startswith("param")]
        if parameters:
            parts.append(table(["parameter", "meaning"], [[f"`{one[1]}`", cell(one[2])] for one in parameters]))
        parts += [f"Returns {' '.join(tag.split()[1:])}" for tag in tags if tag.startswith("return")]
        of = name.removeprefix("joulebus_").split("_")[0]
        found[of if of in OBJECTS else ""].append("\n\n".join(parts))
    return found


def c_types(text):
    """Structs and enums that come after those of shared memory: a table for each."""
    after = text[text.rindex("/**", 0, text.index("enum joulebus_error")):]
    for doc, kind, name, body in re.findall(
            r"(/\*\*(?:(?!\*/)[\s\S])*\*/)\n(?:typedef )?(struct|enum) (joulebus_\w+)[^{;]*\{\n([\s\S]*?)\n\}", after):
        pattern = r"(/\*\*(?:(?!\*/)[\s\S])*\*/)\n\s*(?:([\w ]+?[ *]+)(\w+(?:\[\w+\])?);|(JOULEBUS_\w+) = (\w+))"
        rows = [[f"`{constant or field}`", f"`{(value or type).strip()}`", cell(comment(said))]
                for said, type, field, constant, value in re.findall(pattern, body)]
        head = ["field", "type", "meaning"] if kind == "struct" else ["constant", "value", "meaning"]
        yield "\n\n".join([f"### {name}", *paragraphs(comment(doc)), table(head, rows)])


def c_page():
    text = HEADER.read_text()
    titles = {"": "The library", **{name: name.capitalize() for name in OBJECTS}}
    parts = [f"## {titles[of]}\n\n" + "\n\n".join(functions) for of, functions in c_functions(text).items()]
    return "\n\n".join([*parts, "## Structs and enums", *c_types(text)])


def is_code(part):
    return part.startswith(("    ", "with ", "import ", "from ", "env = "))


def shown(doc):
    """A documentation string as Markdown: code is fenced, lists of arguments are tables."""
    parts = []
    for part in re.split(r"\n\s*\n", doc.replace("``", "`")):
        argument = r"^([a-z_]\w*(?:, [a-z_]\w*)*):\s+"
        if is_code(part):
            parts.append(f"```python\n{textwrap.dedent(part)}\n```")
        elif re.match(argument, part) and all(re.match(argument + r"|\s", line) for line in part.splitlines()):
            names = re.split(argument, part, flags=re.MULTILINE)[1:]
            parts.append(table(["argument", "meaning"], [[f"`{name}`", cell(said)] for name, said in zip(names[::2], names[1::2])]))
        else:
            parts += paragraphs(part)
    return parts


def signature(name, function):
    arguments = function.args
    for argument in [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]:
        argument.annotation = None
    for more in (arguments.vararg, arguments.kwarg):
        if more:
            more.annotation = None
    return f"{name}({re.sub(r'^(self|cls)(, )?', '', ast.unparse(arguments))})"


def call(name, function):
    """A fenced call with its defaults, in lines of at most 100 columns."""
    told = f"joulebus.{signature(name, function)}"
    lines = textwrap.wrap(told, 100, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    return "\n".join(["```python", *lines, "```"])


def first_sentence(doc):
    return cell(re.split(r"\n\s*\n", doc)[0]).replace("``", "`")


def python_entry(name, node):
    if isinstance(node, ast.FunctionDef):
        return [f"## {name}", call(name, node), *shown(ast.get_docstring(node))]
    methods = [one for one in node.body if isinstance(one, ast.FunctionDef)]
    made = next((one for one in methods if one.name in ("__init__", "__new__")), None)
    parts = [f"## {name}"]
    if made and name not in RESULTS:
        parts.append(call(name, made))
    parts += shown(ast.get_docstring(node))
    rows = []
    for one in methods:
        doc = ast.get_docstring(one)
        if doc and not one.name.startswith("_"):
            is_property = any(isinstance(it, ast.Name) and it.id == "property" for it in one.decorator_list)
            rows.append([f"`{one.name if is_property else signature(one.name, one)}`".replace("|", "\\|"), first_sentence(doc)])
    return parts + ([table(["member", "meaning"], rows)] if rows else [])


def native_entry(name):
    """`EnergyPredictor`, which is written in Rust: its comments are its documentation strings."""
    text = NATIVE.read_text()
    says = lambda of: " ".join(re.search(rf"((?: *///.*\n)+)(?: *#.*\n)*.*\b{of}\b", text)[1].replace("///", "").split())
    stub = next(node for node in ast.parse((PACKAGE / "_native.pyi").read_text()).body if getattr(node, "name", "") == name)
    functions = {one.name: one for one in stub.body if isinstance(one, ast.FunctionDef)}
    rows = [[f"`{signature(of, functions[of])}`", cell(says(f"fn {of}"))] for of in ("reset", "step", "step_with_correction")]
    made = call(name, functions["__new__"]).replace("path=...", "path='builtin:gternal-sim'")
    return [f"## {name}", made, says(f"struct {name}"), table(["member", "meaning"], rows)]


def python_page():
    nodes, modules = {}, [*sorted(PACKAGE.glob("*.py"))]
    for module in modules:
        for node in ast.parse(module.read_text()).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                nodes.setdefault(node.name, node)
    package = ast.parse((PACKAGE / "__init__.py").read_text())
    lists = {one.targets[0].id: ast.literal_eval(one.value) for one in package.body
             if isinstance(one, ast.Assign) and getattr(one.targets[0], "id", "") in ("__all__", "_OPTIONAL")}
    names = sorted({*lists["__all__"], *lists["_OPTIONAL"]}, key=lambda name: (name.lower(), name))
    parts = []
    for name in names:
        if name in nodes and ast.get_docstring(nodes[name]):
            parts += python_entry(name, nodes[name])
        elif name == "EnergyPredictor":
            parts += native_entry(name)
    return "\n\n".join(parts)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--check", action="store_true")
    action.add_argument("--write", action="store_true")
    given = parser.parse_args()
    failed = False
    for page, made in [("docs/reference/c-functions.md", c_page()), ("docs/reference/python-classes.md", python_page())]:
        path = ROOT / page
        before = path.read_text()
        head, _, rest = before.partition(BEGIN)
        tail = rest.partition(END)[2]
        after = f"{head}{BEGIN}\n\n{made}\n\n{END}{tail}"
        if before == after:
            continue
        if given.write:
            path.write_text(after)
            continue
        failed = True
        lines = difflib.unified_diff(before.splitlines(), after.splitlines(), "page", "sources", lineterm="", n=0)
        print(f"{page} is not what the sources say: tools/api_pages.py --write", *list(lines)[:20], sep="\n", file=sys.stderr)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
