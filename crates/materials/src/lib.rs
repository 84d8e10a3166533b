//! Fabric models of caphy: StVK and the ten measured fabrics.
