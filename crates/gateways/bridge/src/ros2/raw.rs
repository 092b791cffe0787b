//! Messages as bytes: what they mean is for the mapping to decide, which counts what does not fit.

use std::convert::Infallible;

use rustdds::RepresentationIdentifier;
use rustdds::bytes::Bytes;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};

use crate::mapping::ros::incoming::Received;

/// Plain CDR; of others the reader only says that they came.
const ENCODINGS: &[RepresentationIdentifier] = &[
    RepresentationIdentifier::CDR_LE,
    RepresentationIdentifier::CDR_BE,
];

/// Hands bytes on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Raw;

impl DeserializerAdapter<Received> for Raw {
    type Error = Infallible;
    type Decoded = Received;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        ENCODINGS
    }

    fn transform_decoded(decoded: Received) -> Received {
        decoded
    }
}

impl DefaultDecoder<Received> for Raw {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl Decode<'_, Received> for Raw {
    type Error = Infallible;

    fn decode_bytes(
        self,
        body: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<Received, Infallible> {
        let is_big = encoding == RepresentationIdentifier::CDR_BE;
        Ok(Received::new([0, u8::from(!is_big)], body))
    }
}

impl SerializerAdapter<Vec<u8>> for Raw {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(body: &Vec<u8>) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(body))
    }
}
