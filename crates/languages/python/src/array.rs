//! Numbers from Python, and arrays to Python.

use numpy::{
    Element, IxDyn, PyArray1, PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn,
    PyUntypedArrayMethods as _,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyFloat, PyInt};

/// Maximum number of values that a new array gets as a copy.
const MAX_COPIED: usize = 256;

/// The numbers of an array-like, in row-major order: a copy.
#[derive(Debug)]
pub(crate) struct Numbers {
    pub(crate) values: Vec<f32>,
    pub(crate) shape: Vec<usize>,
}

impl Numbers {
    /// Numbers of any real type, rounded to single precision. `name` is for messages.
    pub(crate) fn read(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Self> {
        let found =
            copy(given, |value: f32| value).or_else(|| copy(given, |value: f64| value as f32));
        let (values, shape) = match found {
            Some(found) => found,
            None => {
                let array = converted(name, given, "float32")?;
                copy(&array, |value: f32| value).ok_or_else(|| unreadable(name, given))?
            }
        };
        Ok(Self { values, shape })
    }

    pub(crate) fn shape_text(&self) -> String {
        shape_text(&self.shape)
    }
}

/// Numbers in double precision, for milliwatts and for single values.
#[derive(Debug)]
pub(crate) struct Doubles {
    pub(crate) values: Vec<f64>,
    /// Empty for a single number.
    pub(crate) shape: Vec<usize>,
}

impl Doubles {
    pub(crate) fn read(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Self> {
        if given.is_instance_of::<PyFloat>() || given.is_exact_instance_of::<PyInt>() {
            let (values, shape) = (vec![given.extract()?], Vec::new());
            return Ok(Self { values, shape });
        }
        if let Some((values, shape)) = copy(given, |value: f64| value) {
            return Ok(Self { values, shape });
        }
        let array = converted(name, given, "float64")?;
        let (values, shape) =
            copy(&array, |value: f64| value).ok_or_else(|| unreadable(name, given))?;
        Ok(Self { values, shape })
    }
}

/// Ids of robots: 0 to 4,294,967,295.
#[derive(Debug)]
pub(crate) struct Ids(pub(crate) Vec<u32>);

impl Ids {
    pub(crate) fn read(name: &str, given: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = given.py();
        let numpy = py.import(intern!(py, "numpy"))?;
        let array = numpy.call_method1(intern!(py, "asarray"), (given,))?;
        let found = array.getattr(intern!(py, "dtype"))?;
        let kind: String = found.getattr(intern!(py, "kind"))?.extract()?;
        let shape: Vec<usize> = array.getattr(intern!(py, "shape"))?.extract()?;
        let [count] = *shape else {
            return Err(shape_error(name, &shape, "(robots,)"));
        };
        if count > 0 && !["i", "u"].contains(&kind.as_str()) {
            let message =
                format!("{name} has dtype {found}, allowed are integers from 0 to {}", u32::MAX);
            // Integers that fit no type of NumPy are objects.
            return Err(match kind.as_str() {
                "O" => PyValueError::new_err(message),
                _ => PyTypeError::new_err(message),
            });
        }
        let wide = if kind == "u" { "uint64" } else { "int64" };
        let array = numpy.call_method1(intern!(py, "asarray"), (array, wide, "C"))?;
        let id = |value: i128| {
            u32::try_from(value).map_err(|_| {
                PyValueError::new_err(format!(
                    "{name} has {value}, allowed are integers from 0 to {}",
                    u32::MAX
                ))
            })
        };
        let ids: PyResult<Vec<u32>> = if kind == "u" {
            let array: PyReadonlyArrayDyn<'_, u64> =
                array.extract().map_err(|_| unreadable(name, given))?;
            let values = array.as_slice().map_err(|_| unreadable(name, given))?;
            values.iter().map(|value| id(i128::from(*value))).collect()
        } else {
            let array: PyReadonlyArrayDyn<'_, i64> =
                array.extract().map_err(|_| unreadable(name, given))?;
            let values = array.as_slice().map_err(|_| unreadable(name, given))?;
            values.iter().map(|value| id(i128::from(*value))).collect()
        };
        Ok(Self(ids?))
    }
}

/// Values and shape of an array that already has type `T` and lies in row-major order.
fn copy<T: Element + Copy, U>(
    given: &Bound<'_, PyAny>,
    each: impl Fn(T) -> U,
) -> Option<(Vec<U>, Vec<usize>)> {
    let array = given.cast::<PyArrayDyn<T>>().ok()?;
    // A contiguous array may also lie column by column.
    if !array.is_c_contiguous() {
        return None;
    }
    let array = array.try_readonly().ok()?;
    let values = array.as_slice().ok()?;
    Some((values.iter().map(|value| each(*value)).collect(), array.shape().to_vec()))
}

/// The array-like as an array of `dtype` in row-major order. Only real numbers are converted: text,
/// objects, truth values and complex numbers are refused.
fn converted<'py>(
    name: &str,
    given: &Bound<'py, PyAny>,
    dtype: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let py = given.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let array = numpy.call_method1(intern!(py, "asarray"), (given,))?;
    let found = array.getattr(intern!(py, "dtype"))?;
    let kind: String = found.getattr(intern!(py, "kind"))?.extract()?;
    let empty = array.getattr(intern!(py, "size"))?.extract::<usize>()? == 0;
    if !empty && !["f", "i", "u"].contains(&kind.as_str()) {
        return Err(PyTypeError::new_err(format!(
            "{name} has dtype {found}, allowed are real numbers (float32, float64, integers)"
        )));
    }
    numpy.call_method1(intern!(py, "asarray"), (array, dtype, "C"))
}

fn unreadable(name: &str, given: &Bound<'_, PyAny>) -> PyErr {
    let kind = given.get_type();
    PyTypeError::new_err(format!("{name} is {kind}, allowed are arrays of real numbers"))
}

/// A new array of these values.
pub(crate) fn array<'py, T: Element + Copy>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    // To lend a vector to NumPy costs more than to copy a short one.
    let flat = if values.len() <= MAX_COPIED {
        PyArray1::from_slice(py, &values)
    } else {
        PyArray1::from_vec(py, values)
    };
    match shape {
        [_] => Ok(flat.to_dyn().clone()),
        _ => flat.reshape(IxDyn(shape)),
    }
}

/// Formats a shape as NumPy's messages do: `(1000, 11)`.
pub(crate) fn shape_text(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => {
            let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
            format!("({})", sizes.join(", "))
        }
    }
}

pub(crate) fn shape_error(name: &str, found: &[usize], allowed: &str) -> PyErr {
    PyValueError::new_err(format!("{name} has shape {}, allowed: {allowed}", shape_text(found)))
}
