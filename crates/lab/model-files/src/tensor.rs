//! Arrays of numbers.

use super::element::Element;
use super::pickle::product;

/// Maximum number of elements of an array whose values are kept. Larger ones have a shape only. The
/// largest of this network has 4,096.
const MAX_ELEMENTS: usize = 1 << 16;

/// An array of numbers of at most eight dimensions.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    element: &'static str,
    values: Vec<f64>,
}

impl Tensor {
    /// A contiguous array. `bytes` holds all elements.
    pub(super) fn dense(
        shape: Vec<usize>,
        element: Element,
        bytes: &[u8],
        big_endian: bool,
        fortran_order: bool,
    ) -> Tensor {
        let strides = strides(&shape, fortran_order);
        Tensor::view(shape, &strides, 0, element, bytes, big_endian)
    }

    /// A view. Elements beyond the end of `bytes` are NaN.
    pub(super) fn view(
        shape: Vec<usize>,
        strides: &[usize],
        offset: usize,
        element: Element,
        bytes: &[u8],
        big_endian: bool,
    ) -> Tensor {
        let count = product(&shape).filter(|&count| count <= MAX_ELEMENTS);
        let value = |number: usize| {
            let mut left = number;
            let mut place = offset;
            for (&size, &stride) in shape.iter().zip(strides).rev() {
                place += left % size * stride;
                left /= size;
            }
            let start = place * element.size();
            let bytes = bytes.get(start..).unwrap_or_default();
            element.decode(bytes, big_endian)
        };
        Tensor {
            values: (0..count.unwrap_or(0)).map(value).collect(),
            element: element.name(),
            shape,
        }
    }

    /// Creates a tensor from Python numbers.
    pub(super) fn from_numbers(shape: Vec<usize>, values: Vec<f64>) -> Tensor {
        Tensor { shape, element: "numbers", values }
    }

    /// Creates a tensor from our own numbers.
    pub(super) fn from_f32(shape: Vec<usize>, values: &[f32]) -> Tensor {
        Tensor {
            shape,
            element: Element::F32.name(),
            values: values.iter().map(|value| f64::from(*value)).collect(),
        }
    }

    /// Size of each dimension.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Element type as in the file, such as `f32`. `numbers` for plain Python numbers.
    pub fn element(&self) -> &'static str {
        self.element
    }

    /// All values in C order. Empty for an array of more than 65,536.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

/// Strides of each dimension, in elements.
fn strides(shape: &[usize], fortran_order: bool) -> Vec<usize> {
    let mut stride = 1_usize;
    let mut next = |&size: &usize| {
        let this = stride;
        stride = stride.saturating_mul(size);
        this
    };
    if fortran_order {
        shape.iter().map(&mut next).collect()
    } else {
        let mut strides: Vec<usize> = shape.iter().rev().map(&mut next).collect();
        strides.reverse();
        strides
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_orders_give_the_same_array() {
        let bytes = [1, 2, 3, 4, 5, 6];
        let c = Tensor::dense(vec![2, 3], Element::U8, &bytes, false, false);
        assert_eq!(c.values(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let fortran = Tensor::dense(vec![3, 2], Element::U8, &bytes, false, true);
        assert_eq!(fortran.values(), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
    }
}
