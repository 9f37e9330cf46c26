/// @file text.hpp -- text in a buffer of the caller, without libc. Text that does not fit is left out.
#pragma once

#include <cstddef>
#include <cstdint>

class Text {
public:
    Text(char* buffer, std::size_t size) : buffer_(buffer), size_(size) { buffer_[0] = '\0'; }

    Text& put(char c) {
        if (n_ + 1U < size_) {
            buffer_[n_++] = c;
            buffer_[n_] = '\0';
        }
        return *this;
    }
    Text& put(const char* text) {
        while (*text != '\0') {
            put(*text++);
        }
        return *this;
    }
    /// Decimal, with zeros in front up to `digits_min` digits.
    Text& number(std::uint64_t value, std::size_t digits_min = 1) {
        char digits[20];
        std::size_t n = 0;
        do {
            digits[n++] = static_cast<char>('0' + static_cast<char>(value % 10U));
            value /= 10U;
        } while (value > 0U || n < digits_min);
        while (n > 0U) {
            put(digits[--n]);
        }
        return *this;
    }
    std::size_t size() const { return n_; }

private:
    char* buffer_;
    std::size_t size_, n_ = 0;
};
