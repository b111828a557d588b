// What the C++ examples share: files, and the hash by which poses are compared.
#pragma once

#include <fstream>
#include <stdexcept>
#include <string>

#include "simulator.hpp"

// A file at an address that rf_init accepts.
inline rigidformer::aligned_bytes read_file(const char *path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) throw std::runtime_error(std::string("cannot open ") + path);
    rigidformer::aligned_bytes bytes(static_cast<std::size_t>(file.tellg()));
    file.seekg(0);
    file.read(reinterpret_cast<char *>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    if (!file) throw std::runtime_error(std::string("cannot read ") + path);
    return bytes;
}

// FNV-1a with 64 bits, of the bytes as they lie in memory: the least significant first.
inline std::uint64_t fnv1a(std::uint64_t sum, const void *data, std::size_t size) {
    const auto *bytes = static_cast<const std::uint8_t *>(data);
    for (std::size_t i = 0; i < size; i++) sum = (sum ^ bytes[i]) * UINT64_C(0x00000100000001b3);
    return sum;
}
