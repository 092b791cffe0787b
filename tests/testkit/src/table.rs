//! Tables of test cases as text, a case a line.

/// The cases of a table: its lines, of cells between ` | `. `\n` in a cell is the end of a line.
pub fn cases(table: &str) -> impl Iterator<Item = Vec<String>> {
    let cell = |cell: &str| cell.trim().replace("\\n", "\n");
    let lines = table.trim().lines();
    lines.map(move |line| line.split(" | ").map(cell).collect())
}
