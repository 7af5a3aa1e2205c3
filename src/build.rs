//! Tells the linker where libtorch lies, so that the binary finds it without any variable set.

fn main() {
    println!("cargo:rerun-if-changed=src/build.rs");
    let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") else { return };
    println!("cargo:rustc-link-arg=-Wl,-rpath,{lib}");
    // A checkout that was moved as a whole still runs.
    let beside = match std::env::var("CARGO_CFG_TARGET_OS").as_deref() {
        Ok("macos") => "@loader_path",
        _ => "$ORIGIN",
    };
    println!("cargo:rustc-link-arg=-Wl,-rpath,{beside}/../../.libtorch/torch/lib");
}
