//! DDS messages as bytes. The mapping decodes them, and counts those that do not fit.

use std::convert::Infallible;

use rustdds::RepresentationIdentifier;
use rustdds::bytes::Bytes;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};

use crate::mapping::ros::incoming::Received;

/// Plain CDR. For other encodings the reader only reports that a message came.
const ENCODINGS: &[RepresentationIdentifier] =
    &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE];

/// Serialises bytes as they are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Raw;

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
