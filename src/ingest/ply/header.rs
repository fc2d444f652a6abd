//! The header of a PLY file (Turk 1994, "The PLY Polygon File Format").

use std::collections::BTreeSet;
use std::path::Path;

use crate::error::{Error, Result};

/// A header longer than this is not one.
const MAX_HEADER: usize = 64 * 1024;

/// How values follow the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

impl Encoding {
    /// The name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::LittleEndian => "binary_little_endian",
            Self::BigEndian => "binary_big_endian",
        }
    }
}

/// The type of one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary file.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number that `bytes` (at least [`Self::size`] of them) begin with; 0 where they are too few.
    pub fn read(self, bytes: &[u8], big_endian: bool) -> f64 {
        fn first<const N: usize>(bytes: &[u8], big_endian: bool) -> [u8; N] {
            let mut value = bytes.first_chunk::<N>().copied().unwrap_or([0; N]);
            if big_endian {
                value.reverse();
            }
            value
        }
        match self {
            Self::I8 => i8::from_le_bytes(first(bytes, big_endian)).into(),
            Self::U8 => u8::from_le_bytes(first(bytes, big_endian)).into(),
            Self::I16 => i16::from_le_bytes(first(bytes, big_endian)).into(),
            Self::U16 => u16::from_le_bytes(first(bytes, big_endian)).into(),
            Self::I32 => i32::from_le_bytes(first(bytes, big_endian)).into(),
            Self::U32 => u32::from_le_bytes(first(bytes, big_endian)).into(),
            Self::F32 => f32::from_le_bytes(first(bytes, big_endian)).into(),
            Self::F64 => f64::from_le_bytes(first(bytes, big_endian)),
        }
    }
}

/// What a property holds per row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    /// A count and as many items.
    List(Scalar, Scalar),
}

/// A named column of an element.
#[derive(Debug)]
pub(super) struct Property {
    pub name: String,
    pub kind: Kind,
}

/// A named table of rows.
#[derive(Debug)]
pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of a binary row; `None` when the element has lists, whose length differs by row.
    pub fn row_size(&self) -> Option<usize> {
        let sizes = self.properties.iter().map(|property| match property.kind {
            Kind::Scalar(scalar) => Some(scalar.size()),
            Kind::List(..) => None,
        });
        sizes.sum()
    }
}

/// A parsed header.
#[derive(Debug)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the first element's rows begin, in bytes from the start of the file.
    pub data_offset: usize,
}

impl Header {
    /// Parses the header that `bytes` begin with; messages name `path` and the line.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let head = &bytes[..bytes.len().min(MAX_HEADER)];
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut names = BTreeSet::new();
        let mut offset = 0;
        for (number, line) in head.split_inclusive(|&byte| byte == b'\n').enumerate() {
            let invalid = |what: String| Error::invalid(path, format!("header line {}", number + 1), what);
            if !line.ends_with(b"\n") {
                break;
            }
            offset += line.len();
            // Comments may be in any encoding; the words that matter are ASCII.
            let line = String::from_utf8_lossy(line);
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["ply"] if number == 0 => {}
                _ if number == 0 => return Err(invalid("a PLY file begins with the line 'ply'".into())),
                [] | ["comment" | "obj_info", ..] => {}
                ["format", name, "1.0"] if encoding.is_none() => {
                    encoding = Some(match *name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        _ => return Err(invalid(format!("'{name}' is not a PLY format"))),
                    });
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| invalid(format!("'{count}' is not a count")))?;
                    if elements.iter().any(|element| element.name == *name) {
                        return Err(invalid(format!("element '{name}' is declared twice")));
                    }
                    names.clear();
                    elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                }
                ["property", kind @ .., name] => {
                    let scalar =
                        |name: &str| Scalar::parse(name).ok_or_else(|| invalid(format!("'{name}' is not a PLY type")));
                    let kind = match kind {
                        [one] => Kind::Scalar(scalar(one)?),
                        ["list", count, item] => Kind::List(scalar(count)?, scalar(item)?),
                        _ => {
                            return Err(invalid(
                                "expected 'property TYPE NAME' or 'property list TYPE TYPE NAME'".into(),
                            ));
                        }
                    };
                    let element = elements.last_mut().ok_or_else(|| invalid("a property before any element".into()))?;
                    if !names.insert((*name).to_string()) {
                        return Err(invalid(format!("property '{name}' is declared twice")));
                    }
                    element.properties.push(Property { name: (*name).into(), kind });
                }
                ["end_header"] => {
                    let encoding = encoding.ok_or_else(|| invalid("no 'format' line before it".into()))?;
                    return Ok(Self { encoding, elements, data_offset: offset });
                }
                _ => return Err(invalid(format!("'{}' is not a PLY header line", line.trim_end()))),
            }
        }
        let what =
            if bytes.len() > MAX_HEADER { "no 'end_header' in the first 64 KiB" } else { "no 'end_header' line" };
        Err(Error::invalid(path, format!("header, byte {offset}"), what))
    }
}
