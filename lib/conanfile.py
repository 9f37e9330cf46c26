"""The core for Conan 2: sources, headers and the function that builds a vehicle from them."""

import os

from conan import ConanFile
from conan.tools.files import copy


class Lpvguard(ConanFile):
    name = "lpvguard"
    version = "0.4.0"
    description = "On-line monitor of an uncertain LPV vehicle model, and the controller that it guards"
    license = "MIT"
    topics = ("control", "monitor", "automotive", "can", "embedded")
    package_type = "unknown"  # a library is built for each vehicle, in the user's own build
    options = {"eigen": ["package", "system"]}  # noqa: RUF012 (Conan's own form)
    default_options = {"eigen": "package"}  # noqa: RUF012
    no_copy_source = True

    def export_sources(self):
        copy(self, "LICENSE", os.path.dirname(self.recipe_folder), self.export_sources_folder)
        for pattern in ("include/*", "src/*", "vehicles/*", "*.cmake"):
            copy(self, pattern, self.recipe_folder, self.export_sources_folder)

    def requirements(self):
        if self.options.eigen == "package":
            self.requires("eigen/3.4.0")

    def package_id(self):
        self.info.clear()

    def package(self):
        copy(self, "LICENSE", self.source_folder, os.path.join(self.package_folder, "licenses"))
        for pattern in ("include/*", "src/*", "vehicles/*", "lpvguard*.cmake"):
            copy(self, pattern, self.source_folder, self.package_folder)

    def package_info(self):
        # find_package(lpvguard) finds the project's own lpvguardConfig.cmake.
        self.cpp_info.set_property("cmake_find_mode", "none")
        self.cpp_info.builddirs = ["."]
        self.cpp_info.includedirs = []
        self.cpp_info.libdirs = []
        self.cpp_info.bindirs = []
