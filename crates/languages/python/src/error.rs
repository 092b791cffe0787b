//! Exceptions.

use std::io;
use std::path::Path;

use pyo3::exceptions::{PyException, PyOSError};
use pyo3::{PyErr, create_exception};

create_exception!(
    joulebus,
    Error,
    PyException,
    "Base of the package's exceptions. The message says what was found, what is allowed and what \
     to do."
);
create_exception!(
    joulebus,
    ModelError,
    Error,
    "A model file is refused, or does not fit the question."
);
create_exception!(
    joulebus,
    ConnectError,
    Error,
    "A config is refused, a fleet cannot be joined, or a service not be opened. While publishing: \
     files of this process were removed, so it must connect again."
);
create_exception!(
    joulebus,
    ReadError,
    Error,
    "Frames could not be read. The next call may succeed."
);
create_exception!(joulebus, PublishError, Error, "A frame was not sent. The next may be.");

create_exception!(joulebus, RecordingError, Error, "A capture or a trial is refused.");

/// An error of the system on a file, as Python's own exception: `FileNotFoundError` and so on.
pub(crate) fn of_file(path: &Path, error: &io::Error) -> PyErr {
    let message = format!("cannot read {}: {error}", path.display());
    let kind: PyErr = io::Error::new(error.kind(), message.clone()).into();
    match error.kind() {
        // `PyErr` knows a class for these kinds. Its message is ours.
        io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied => kind,
        _ => PyOSError::new_err(message),
    }
}

/// Reason that reading failed. For a frame of another version also the version to install.
pub(crate) fn of_read(error: &joulebus_consumer::ReadError) -> String {
    match error {
        joulebus_consumer::ReadError::Schema { .. } => format!(
            "{error}. This package is joulebus {}: `joulebus --version` on the worker's side says \
             which release to install",
            env!("CARGO_PKG_VERSION")
        ),
        _ => error.to_string(),
    }
}
