/// @file at_the_end.hpp -- items at the end of the memory that may be read or written, on Linux.
#pragma once

#if defined(__linux__)
#include "../catch.hpp"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <vector>

namespace {

// Copies of items, with nothing behind them that may be touched: the program ends there.
template <class T>
class AtTheEnd {
public:
    explicit AtTheEnd(const std::vector<T>& items) : size_(whole_pages(items.size() * sizeof(T))) {
        begin_ = mmap(nullptr, size_ + one_page(), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        REQUIRE(begin_ != MAP_FAILED);
        REQUIRE(mprotect(static_cast<char*>(begin_) + size_, one_page(), PROT_NONE) == 0);
        std::copy(items.begin(), items.end(), reinterpret_cast<T*>(static_cast<char*>(begin_) + size_) - items.size());
        items_ = reinterpret_cast<T*>(static_cast<char*>(begin_) + size_) - items.size();
    }
    ~AtTheEnd() { munmap(begin_, size_ + one_page()); }
    AtTheEnd(const AtTheEnd&) = delete;
    AtTheEnd& operator=(const AtTheEnd&) = delete;
    T* get() const { return items_; }

private:
    static std::size_t one_page() { return static_cast<std::size_t>(sysconf(_SC_PAGESIZE)); }
    static std::size_t whole_pages(std::size_t bytes) { return (bytes + one_page() - 1U) / one_page() * one_page(); }

    std::size_t size_;  // of what may be touched
    void* begin_ = nullptr;
    T* items_ = nullptr;
};

}  // namespace
#endif
