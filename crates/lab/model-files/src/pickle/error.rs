//! Errors of reading a pickle.

/// Errors of reading a pickle. Offsets are bytes from the start of the file, or of the archive
/// member that contains the pickle. Nothing in a pickle is executed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PickleError {
    /// The bytes end too early, or a length is wrong.
    #[error(
        "byte {at}: {opcode} needs {needs} bytes, {left} are left. The file is truncated or corrupt"
    )]
    Truncated {
        /// Offset of the opcode.
        at: usize,
        /// Name of the opcode.
        opcode: &'static str,
        /// Bytes needed.
        needs: u64,
        /// Bytes left.
        left: usize,
    },
    /// An opcode that tensors and plain containers do not need.
    #[error(
        "byte {at}: opcode {name} ({code:#04x}) is refused. Tensors and plain containers need no \
         such opcode"
    )]
    Opcode {
        /// Offset of the opcode.
        at: usize,
        /// Its byte.
        code: u8,
        /// Its name.
        name: &'static str,
    },
    /// A Python function or class that is not on the allowlist.
    #[error(
        "byte {at}: `{name}` is refused: it is none of the functions and classes that tensors and \
         plain containers need, and nothing was run. If this is a model of your own, save \
         `model.state_dict()` or a dict of arrays and numbers"
    )]
    Global {
        /// Offset of the opcode that names it.
        at: usize,
        /// Module and name as in the file.
        name: String,
    },
    /// A recognised function with unsupported arguments.
    #[error("byte {at}: {function} {detail}")]
    Call {
        /// Offset of the call.
        at: usize,
        /// Name of the function.
        function: &'static str,
        /// The problem with the expected value.
        detail: String,
    },
    /// An opcode that is invalid in its context.
    #[error("byte {at}: {opcode} {detail}. The file is corrupt")]
    Program {
        /// Offset of the opcode.
        at: usize,
        /// Name of the opcode.
        opcode: &'static str,
        /// The problem with the expected value.
        detail: String,
    },
    /// More values than any model file has.
    #[error("byte {at}: more than {allowed} values. Check that it is a model file")]
    TooMany {
        /// Offset of the opcode that exceeded the limit.
        at: usize,
        /// Values allowed.
        allowed: usize,
    },
}

/// A name from a file, escaped for terminals.
pub(super) fn shown(name: &str) -> String {
    let plain = |character: char| {
        if character.is_control() { char::REPLACEMENT_CHARACTER } else { character }
    };
    name.chars().map(plain).take(200).collect()
}
