/// @file marked_table.hpp -- a table of lib/REQUIREMENTS.md that a test writes: between two marks, compared, or renewed on request.
#pragma once

#include "catch.hpp"

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

/// The part of a document between "<!-- NAME: written by `PROGRAM`, do not edit -->" and "<!-- NAME: end -->".
class MarkedTable {
public:
    MarkedTable(const std::string& name, const std::string& program)
        : begin_mark_("<!-- " + name + ": written by `" + program + "`, do not edit -->\n"), end_mark_("<!-- " + name + ": end -->\n") {
        std::ifstream file(LPVG_REQUIREMENTS);
        document_.assign(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
        const std::size_t begin = document_.find(begin_mark_), end = document_.find(end_mark_);
        REQUIRE(begin != std::string::npos);
        REQUIRE(end != std::string::npos);
        first_ = begin + begin_mark_.size();
        length_ = end - first_;
    }

    std::string text() const { return document_.substr(first_, length_); }

    /// Fails where the document holds another text; with the environment's `variable` writes the renewed document to the file it names.
    void require(const std::string& rows, const char* variable) {
        if (const char* const target = std::getenv(variable)) {
            document_.replace(first_, length_, rows);
            std::ofstream(target) << document_;
        } else {
            CHECK(text() == rows);
        }
    }

private:
    std::string begin_mark_, end_mark_, document_;
    std::size_t first_ = 0U, length_ = 0U;
};
