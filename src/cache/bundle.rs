//! Named parts in one entry.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Parts by name, in order: `name length (u32), name, content length (u64), content`, little-endian.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Bundle(Vec<(String, Vec<u8>)>);

impl Bundle {
    /// Adds a part.
    pub fn add(&mut self, name: impl Into<String>, content: Vec<u8>) {
        self.0.push((name.into(), content));
    }

    /// Adds a part that holds `value` as JSON. Maps must have text as keys.
    pub fn add_json(&mut self, name: &str, value: &impl Serialize) {
        self.add(name, serde_json::to_vec(value).unwrap_or_default());
    }

    /// The content of the first part called `name`.
    pub fn get(&self, name: &str) -> Option<&[u8]> {
        self.parts().find(|(own, _)| *own == name).map(|(_, content)| content)
    }

    /// What the part called `name` holds as JSON; `None` where it is absent or something else.
    pub fn get_json<T: DeserializeOwned>(&self, name: &str) -> Option<T> {
        serde_json::from_slice(self.get(name)?).ok()
    }

    /// All parts with their names.
    pub fn parts(&self) -> impl Iterator<Item = (&str, &[u8])> {
        self.0.iter().map(|(name, content)| (name.as_str(), content.as_slice()))
    }

    /// The parts as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.0.iter().map(|(name, content)| 12 + name.len() + content.len()).sum());
        for (name, content) in &self.0 {
            bytes.extend((name.len() as u32).to_le_bytes());
            bytes.extend(name.as_bytes());
            bytes.extend((content.len() as u64).to_le_bytes());
            bytes.extend(content);
        }
        bytes
    }

    /// The parts that [`Self::to_bytes`] wrote; `None` for other bytes.
    pub fn from_bytes(mut bytes: &[u8]) -> Option<Self> {
        let mut parts = Vec::new();
        while !bytes.is_empty() {
            let (length, rest) = bytes.split_first_chunk()?;
            let (name, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
            let (length, rest) = rest.split_first_chunk()?;
            let (content, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
            parts.push((std::str::from_utf8(name).ok()?.to_owned(), content.to_vec()));
            bytes = rest;
        }
        Some(Self(parts))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_return_as_they_were_and_cut_off_bytes_are_none() {
        let mut bundle = Bundle::default();
        bundle.add_json("numbers", &[0.1, -0.0, 1e300]);
        bundle.add("empty", Vec::new());
        bundle.add("bytes", vec![0, 255, 10]);
        let bytes = bundle.to_bytes();
        assert_eq!(Bundle::from_bytes(&bytes).unwrap(), bundle);
        assert_eq!(bundle.get_json::<Vec<f64>>("numbers").unwrap()[2], 1e300);
        assert_eq!(bundle.get("absent"), None);
        let whole = [0, bytes.len() - 3 - 17, bytes.len() - 3 - 17 - 17, bytes.len()];
        for length in (0..bytes.len()).filter(|length| !whole.contains(length)) {
            assert_eq!(Bundle::from_bytes(&bytes[..length]), None, "{length}");
        }
    }
}
