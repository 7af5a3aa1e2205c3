//! Tells the linker where libtorch lies, so that the binary finds it without any variable set.

fn main() {
    println!("cargo:rerun-if-changed=src/build.rs");
    let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") else { return };
    println!("cargo:rustc-link-arg=-Wl,-rpath,{lib}");
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN/../../.libtorch/torch/lib");
}
