//! Every material keeps the promise of its trait, in every variant that changes what it answers.

macro_rules! subjects {
    ($($name:ident: $toml:expr;)*) => {
        $(
            mod $name {
                use caphy_core::conformance::material::MaterialSubject;
                use caphy_materials as _;
                caphy_core::conformance_tests!(material, MaterialSubject::linked($toml));
            }
        )*
    };
}

subjects! {
    stvk_bulk: "type = \"stvk\"\nlambda_pa = 4.4e4\nmu_pa = 2.4e4\nthickness_m = 4.7e-4";
    stvk_sheet: "type = \"stvk\"\nlambda_n_per_m = 20.9\nmu_n_per_m = 11.1\nhinge_length = \"current\"";
    stvk_young: "type = \"stvk\"\nyoung_pa = 0.7e5\npoisson = 0.485\nthickness_m = 4.7e-4\ndensity_kg_per_m2 = 0.2";
    neo_hookean: "type = \"neo_hookean\"\nyoung_pa = 0.7e5\npoisson = 0.485\nthickness_m = 4.7e-4";
    neo_hookean_sheet: "type = \"neo_hookean\"\nlambda_n_per_m = -5.0\nmu_n_per_m = 11.1\nhinge_length = \"current\"";
    ivory: "type = \"measured\"\nfabric = \"ivory-rib-knit\"";
    pink: "type = \"measured\"\nfabric = \"pink-ribbon-brown\"";
    white_dots: "type = \"measured\"\nfabric = \"white-dots-on-blk\"";
    navy: "type = \"measured\"\nfabric = \"navy-sparkle-sweat\"";
    camel: "type = \"measured\"\nfabric = \"camel-ponte-roma\"";
    gray: "type = \"measured\"\nfabric = \"gray-interlock\"";
    denim: "type = \"measured\"\nfabric = \"11oz-black-denim\"";
    swim: "type = \"measured\"\nfabric = \"white-swim-solid\"";
    tango: "type = \"measured\"\nfabric = \"tango-red-jet-set\"";
    royal: "type = \"measured\"\nfabric = \"royal-target\"";
    isotropic: "type = \"measured\"\nfabric = \"royal-target\"\nform = \"isotropic\"";
    direct: "type = \"measured\"\nfabric = \"camel-ponte-roma\"\nlookup = \"direct\"";
    full: "type = \"measured\"\nfabric = \"navy-sparkle-sweat\"\nstiffness_gradient = \"full\"";
    full_isotropic: "type = \"measured\"\nfabric = \"ivory-rib-knit\"\nstiffness_gradient = \"full\"\nform = \"isotropic\"";
    faithful: "type = \"measured\"\nfabric = \"white-dots-on-blk\"\nbending = \"faithful\"\nedge_length = \"current\"";
}
