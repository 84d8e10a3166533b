//! Every net keeps the promise of its trait.

macro_rules! subjects {
    ($($name:ident: $toml:expr;)*) => {
        $(
            mod $name {
                use caphy_core::conformance::net::NetSubject;
                use caphy_nets as _;
                caphy_core::conformance_tests!(net, NetSubject::linked($toml));
            }
        )*
    };
}

subjects! {
    gru: "type = \"gru\"\nlayers = 2\nhidden = 11";
    gru_of_one: "type = \"gru\"\nlayers = 1\nhidden = 1";
    mlp: "type = \"mlp\"\nhidden = [13, 8]";
    mlp_tanh: "type = \"mlp\"\nhidden = [5]\nactivation = \"tanh\"";
    mlp_relu: "type = \"mlp\"\nhidden = [24]\nactivation = \"relu\"";
    linear: "type = \"mlp\"\nhidden = []";
}
