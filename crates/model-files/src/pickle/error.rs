//! Why a pickle was refused.

/// Why a pickle was refused. Places are bytes from the first of the file, or of the member of an
/// archive that the pickle stands in. Nothing in a pickle is run, refused or not.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PickleError {
    /// The bytes end too soon, or a length is wrong.
    #[error("byte {at}: {opcode} needs {needs} bytes, {left} are left; the file is cut or damaged")]
    Truncated {
        /// Place of the opcode.
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
        "byte {at}: opcode {name} ({code:#04x}) is refused; tensors and plain containers need no \
         such opcode"
    )]
    Opcode {
        /// Place of the opcode.
        at: usize,
        /// Its byte.
        code: u8,
        /// Its name.
        name: &'static str,
    },
    /// A Python function or class that is not known to be harmless.
    #[error(
        "byte {at}: `{name}` is refused: it is none of the functions and classes that tensors and \
         plain containers need, and nothing was run; if this is a model of your own, save \
         `model.state_dict()` or a dict of arrays and numbers"
    )]
    Global {
        /// Place of the opcode that names it.
        at: usize,
        /// Module and name as in the file.
        name: String,
    },
    /// A known function with arguments that it never has.
    #[error("byte {at}: {function} {detail}")]
    Call {
        /// Place of the call.
        at: usize,
        /// Name of the function.
        function: &'static str,
        /// What was found and what is allowed.
        detail: String,
    },
    /// An opcode that cannot stand where it stands.
    #[error("byte {at}: {opcode} {detail}; the file is damaged")]
    Program {
        /// Place of the opcode.
        at: usize,
        /// Name of the opcode.
        opcode: &'static str,
        /// What was found and what is allowed.
        detail: String,
    },
    /// More values than any model file has.
    #[error("byte {at}: more than {allowed} values; is it another file?")]
    TooMany {
        /// Place of the opcode that made one too many.
        at: usize,
        /// Values allowed.
        allowed: usize,
    },
}

/// A name from a file as it may be shown in a terminal.
pub(super) fn shown(name: &str) -> String {
    let plain = |character: char| {
        if character.is_control() {
            char::REPLACEMENT_CHARACTER
        } else {
            character
        }
    };
    name.chars().map(plain).take(200).collect()
}
