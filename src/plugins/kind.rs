//! The kinds of plugin.

use caphy_core::body::BodySpec;
use caphy_core::host::PluginKind;
use caphy_core::material::MaterialSpec;
use caphy_core::net::NetSpec;
use caphy_core::segmenter::SegmenterSpec;
use caphy_garment::template::TemplateSpec;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Which trait a plugin implements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// [`caphy_core::material::MaterialModel`].
    Material,
    /// [`caphy_core::net::DeformationNet`].
    Net,
    /// [`caphy_core::body::BodyModel`].
    Body,
    /// [`caphy_core::segmenter::Segmenter`].
    Segmenter,
    /// [`caphy_garment::template::TemplateSource`].
    Template,
}

impl Kind {
    /// All of them.
    pub const ALL: [Kind; 5] = [Kind::Material, Kind::Net, Kind::Body, Kind::Segmenter, Kind::Template];
    /// Those whose promises [`caphy_core::conformance`] can check.
    pub const CHECKED: [Kind; 4] = [Kind::Material, Kind::Net, Kind::Body, Kind::Segmenter];

    /// Name of its table in a configuration.
    pub fn key(self) -> &'static str {
        match self {
            Kind::Material => "material",
            Kind::Net => "net",
            Kind::Body => "body",
            Kind::Segmenter => "segmenter",
            Kind::Template => "template",
        }
    }

    /// The kind in the plugin interface; the others cannot be loaded.
    pub(super) fn loadable(self) -> Option<PluginKind> {
        match self {
            Kind::Material => Some(PluginKind::Material),
            Kind::Net => Some(PluginKind::Net),
            Kind::Body | Kind::Segmenter | Kind::Template => None,
        }
    }

    /// Types of the crates that are linked into this program.
    pub fn linked_names(self) -> Vec<String> {
        // typetag has no list, but its refusal of an impossible type names them all.
        let nobody = toml::Table::from_iter([("type".to_string(), toml::Value::from(""))]);
        let refusal = self.linked(&nobody).err().unwrap_or_default();
        let expected = refusal.split_once("expected").map_or("", |parts| parts.1);
        expected.split('`').skip(1).step_by(2).map(str::to_string).collect()
    }

    /// A linked plugin's table with every default filled in, or the parser's words.
    pub(super) fn linked(self, table: &toml::Table) -> Result<toml::Table, String> {
        match self {
            Kind::Material => filled::<dyn MaterialSpec>(table),
            Kind::Net => filled::<dyn NetSpec>(table),
            Kind::Body => filled::<dyn BodySpec>(table),
            Kind::Segmenter => filled::<dyn SegmenterSpec>(table),
            Kind::Template => filled::<dyn TemplateSpec>(table),
        }
    }
}

fn filled<S: ?Sized>(table: &toml::Table) -> Result<toml::Table, String>
where
    Box<S>: DeserializeOwned + Serialize,
{
    let spec: Box<S> = table.clone().try_into().map_err(|e: toml::de::Error| e.message().trim().to_string())?;
    toml::Table::try_from(&spec).map_err(|e| e.to_string())
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.key())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_knows_its_types() {
        assert_eq!(Kind::Net.linked_names(), ["gru", "mlp"]);
        for kind in Kind::ALL {
            assert!(kind.linked_names().len() >= 2, "{kind}");
        }
    }
}
