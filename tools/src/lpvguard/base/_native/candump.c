/* Parses candump logs (candump -l and -L, one frame a line), about 50 ns a frame.
 *
 *     (1345212884.318850) can0 18F0093E#FFFF00FF00FF00FF        classic, 29-bit identifier (3 digits: 11-bit)
 *     (1345212884.318850) can0 123##1 00..                      CAN FD: '##', one digit of flags, up to 64 bytes
 *     (1345212884.318850) can0 123#R4                           remote
 *
 * A suffix after the data (direction, raw length) is ignored. Error reports (identifier flag 0x20000000) and remote frames
 * are counted and left out. A line that fits none of these is counted, and the first one's number kept.
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum {
    NAME = 16,
    CHANNELS = 64,
    MAX_BYTES = 64
};
enum {
    BAD_LINES,
    FIRST_BAD_LINE,
    ERROR_FRAMES,
    REMOTE_FRAMES,
    N_CHANNELS,
    LONGEST,
    N_COUNTS
};

/* Value of a hexadecimal digit plus one; 0 for any other character. */
static const uint8_t kHex[256] = {['0'] = 1,  ['1'] = 2,  ['2'] = 3,  ['3'] = 4,  ['4'] = 5,  ['5'] = 6,  ['6'] = 7,  ['7'] = 8,
                                  ['8'] = 9,  ['9'] = 10, ['A'] = 11, ['B'] = 12, ['C'] = 13, ['D'] = 14, ['E'] = 15, ['F'] = 16,
                                  ['a'] = 11, ['b'] = 12, ['c'] = 13, ['d'] = 14, ['e'] = 15, ['f'] = 16};

static int hex(char c) { return kHex[(unsigned char)c] - 1; }

/* Unsigned decimal; *p moves behind it. Returns -1 without a digit or beyond 17 digits. */
static int64_t decimal(const char** p, const char* end) {
    const char* start = *p;
    int64_t value = 0;
    for (; *p < end && **p >= '0' && **p <= '9'; ++*p) value = *p - start < 17 ? value * 10 + (**p - '0') : value;
    return *p > start && *p - start <= 17 ? value : -1;
}

/* "(seconds.fraction)" in nanoseconds, or -1. */
static int64_t stamp(const char** p, const char* end) {
    if (*p == end || **p != '(') return -1;
    ++*p;
    const char* first = *p;
    const int64_t seconds = decimal(p, end);
    if (seconds < 0 || *p - first > 10 || seconds > 9000000000LL || *p == end || **p != '.') return -1;
    ++*p;
    const char* start = *p;
    int64_t fraction = decimal(p, end);
    if (fraction < 0 || *p - start > 9 || *p == end || **p != ')') return -1;
    for (int64_t digits = *p - start; digits < 9; ++digits) fraction *= 10;
    ++*p;
    return seconds * 1000000000LL + fraction;
}

static int channel_of(const char* name, size_t length, char* names, int64_t* counts) {
    for (int64_t i = 0; i < counts[N_CHANNELS]; ++i)
        if (memcmp(names + NAME * i, name, length) == 0 && names[NAME * i + (int64_t)length] == 0) return (int)i;
    if (counts[N_CHANNELS] == CHANNELS) return -1;
    memcpy(names + NAME * counts[N_CHANNELS], name, length);
    return (int)counts[N_CHANNELS]++;
}

/* Moves *p over spaces; returns how many. */
static ptrdiff_t spaces(const char** p, const char* end) {
    const char* start = *p;
    while (*p < end && **p == ' ') ++*p;
    return *p - start;
}

/* One line, begin <= p < end. Returns 1: frame n written, 0: left out on purpose, -1: not a frame. */
static int line(const char* p, const char* end, int64_t n, int width, int64_t* t_ns, uint32_t* id, uint8_t* channel, uint8_t* length,
                uint8_t* data, char* names, int64_t* counts) {
    spaces(&p, end);
    const int64_t t = stamp(&p, end);
    if (t < 0 || spaces(&p, end) == 0) return -1;
    const char* name = p;
    while (p < end && (unsigned char)*p > ' ') ++p;
    const size_t name_length = (size_t)(p - name);
    if (name_length == 0 || name_length >= NAME || spaces(&p, end) == 0) return -1;
    const char* start = p;
    uint32_t identifier = 0;
    for (int digit; p < end && p - start < 9 && (digit = hex(*p)) >= 0; ++p) identifier = identifier << 4 | (uint32_t)digit;
    const int64_t digits = p - start;
    if ((digits != 3 && digits != 8) || p == end || *p != '#') return -1;
    ++p;
    const int report = digits == 8 && (identifier & 0x20000000u);
    if (p < end && (*p == 'R' || *p == 'r')) {
        ++counts[report ? ERROR_FRAMES : REMOTE_FRAMES];
        return 0;
    }
    if (p < end && *p == '#') {
        if (++p == end || hex(*p) < 0) return -1;
        ++p;
    }
    uint8_t bytes[MAX_BYTES];
    int count = 0;
    for (; p + 1 < end && count < MAX_BYTES; p += 2, ++count) {
        const int high = hex(p[0]), low = hex(p[1]);
        if (high < 0 || low < 0) break;
        bytes[count] = (uint8_t)(high << 4 | low);
    }
    if (p < end && *p != ' ' && *p != '_' && !(*p == '\r' && p + 1 == end)) return -1;
    if (report) {
        ++counts[ERROR_FRAMES];
        return 0;
    }
    if (count > counts[LONGEST]) counts[LONGEST] = count;
    const int index = channel_of(name, name_length, names, counts);
    if (index < 0) return -1;
    t_ns[n] = t;
    id[n] = digits == 8 ? (identifier & 0x1FFFFFFFu) | 0x80000000u : identifier;
    channel[n] = (uint8_t)index;
    length[n] = (uint8_t)count;
    const int kept = count < width ? count : width;
    memcpy(data + (int64_t)width * n, bytes, (size_t)kept);
    memset(data + (int64_t)width * n + kept, 0, (size_t)(width - kept));
    return 1;
}

/* Fills t_ns, id, channel, length [capacity], data [capacity, width], names [CHANNELS, NAME] (zeroed by the caller) and
 * counts [N_COUNTS]; returns the number of frames. capacity >= number of lines. When counts[LONGEST] > width, data are
 * cut: parse again with a larger width. */
int64_t lpvg_candump(const char* text, int64_t size, int width, int64_t* t_ns, uint32_t* id, uint8_t* channel, uint8_t* length,
                     uint8_t* data, char* names, int64_t* counts) {
    int64_t n = 0, number = 0;
    memset(counts, 0, N_COUNTS * sizeof *counts);
    for (const char *p = text, *last = text + size; p < last; ++number) {
        const char* end = memchr(p, '\n', (size_t)(last - p));
        if (end == NULL) end = last;
        const int blank = end == p || (end == p + 1 && *p == '\r');
        const int result = blank ? 0 : line(p, end, n, width, t_ns, id, channel, length, data, names, counts);
        if (result > 0) ++n;
        if (result < 0 && counts[BAD_LINES]++ == 0) counts[FIRST_BAD_LINE] = number + 1;
        p = end + 1;
    }
    return n;
}
