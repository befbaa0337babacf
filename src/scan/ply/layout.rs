//! Where the values of an entry lie, and how their bytes are read.

use ply_rs::ply::{ElementDef, Encoding, PropertyType, ScalarType};

/// Bytes of a value.
pub fn size(scalar: &ScalarType) -> usize {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

/// The value at the start of `bytes`; f64 holds every value of every type.
#[inline]
pub fn decode(scalar: &ScalarType, bytes: &[u8], encoding: Encoding) -> f64 {
    macro_rules! number {
        ($type:ty) => {{
            let bytes = bytes[..size_of::<$type>()].try_into().unwrap();
            match encoding {
                Encoding::BinaryBigEndian => <$type>::from_be_bytes(bytes) as f64,
                _ => <$type>::from_le_bytes(bytes) as f64,
            }
        }};
    }
    match scalar {
        ScalarType::Char => number!(i8),
        ScalarType::UChar => number!(u8),
        ScalarType::Short => number!(i16),
        ScalarType::UShort => number!(u16),
        ScalarType::Int => number!(i32),
        ScalarType::UInt => number!(u32),
        ScalarType::Float => number!(f32),
        ScalarType::Double => number!(f64),
    }
}

/// The value of a packed colour. Many colours as bits are no number of which a float keeps the bits.
#[inline]
pub fn decode_packed(scalar: &ScalarType, bytes: &[u8], encoding: Encoding) -> f64 {
    match (scalar, decode(scalar, bytes, encoding)) {
        (ScalarType::Float, value) if value.fract() != 0.0 || value.abs() >= 2f64.powi(32) => {
            decode(&ScalarType::UInt, bytes, encoding)
        }
        (_, value) => value,
    }
}

/// Where property `column` of a binary entry begins, or for the number of properties where the
/// entry ends; `None` if lists make it vary.
pub fn offset(element: &ElementDef, column: usize) -> Option<usize> {
    let before = element.properties.values().take(column);
    before
        .map(|property| match &property.data_type {
            PropertyType::Scalar(scalar) => Some(size(scalar)),
            PropertyType::List(..) => None,
        })
        .sum()
}

/// The least number of bytes that all entries can take.
pub fn least_bytes(element: &ElementDef, encoding: Encoding) -> u128 {
    let least = |property: &PropertyType| match (encoding, property) {
        // A digit and what parts it from the next.
        (Encoding::Ascii, _) => 2,
        (_, PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) => size(scalar),
    };
    let each: usize = element
        .properties
        .values()
        .map(|p| least(&p.data_type))
        .sum();
    element.count as u128 * each as u128
}
