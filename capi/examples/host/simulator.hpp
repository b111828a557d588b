// RigidFormer for C++17: owns its memory, throws what goes wrong.
#pragma once

#include <rigidformer.h>

#include <cstddef>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

namespace rigidformer {

// A refused call.
struct error : std::runtime_error {
    explicit error(rf_detail detail) : std::runtime_error(text(detail)), detail(detail) {}
    rf_detail detail;

private:
    static std::string text(const rf_detail &detail) {
        std::string text = rf_error_string(detail.code);
        if (detail.unit != RF_NONE) text += "; unit " + std::to_string(detail.unit);
        if (detail.index != RF_NONE) text += ", index " + std::to_string(detail.index);
        if (detail.expected != 0) {
            text += "; found " + std::to_string(detail.found);
            text += ", expected " + std::to_string(detail.expected);
        }
        return text;
    }
};

// Bytes at an address that rf_init accepts.
class aligned_bytes {
public:
    explicit aligned_bytes(std::size_t size)
        : size_(size), data_(static_cast<std::uint8_t *>(
                           ::operator new(size, std::align_val_t{RF_ALIGNMENT}))) {}
    std::uint8_t *data() { return data_.get(); }
    std::size_t size() const { return size_; }

private:
    struct release {
        void operator()(std::uint8_t *data) const {
            ::operator delete(data, std::align_val_t{RF_ALIGNMENT});
        }
    };
    std::size_t size_;
    std::unique_ptr<std::uint8_t, release> data_;
};

// A simulator; the model must outlive it. It may be moved: its memory stays where it is.
class simulator {
public:
    simulator(const std::uint8_t *model, std::size_t bytes, std::uint32_t max_units,
              std::uint32_t max_points)
        : simulator(rf_config{RF_ABI_VERSION, max_units, max_points, 0, model, bytes}) {}

    explicit simulator(const rf_config &config) : memory_(needed(config)) {
        rf_detail detail{};
        if (rf_init(&config, memory_.data(), memory_.size(), &handle_, &detail) != RF_OK)
            throw error(detail);
    }

    rf_observation observe(std::uint32_t step, const rf_units &units, const float *previous,
                           const float *current) {
        rf_observation observation{};
        check(rf_observe(handle_, step, &units, previous, current, &observation));
        return observation;
    }

    void set_command(const std::vector<float> &numbers) {
        check(rf_set_command(handle_, numbers.data(), numbers.size()));
    }

    rf_step_report step() {
        rf_step_report report{};
        check(rf_step(handle_, &report));
        return report;
    }

    std::size_t size() const {
        std::uint32_t count = 0;
        check(rf_unit_count(handle_, &count));
        return count;
    }

    std::vector<rf_pose> poses() const {
        std::vector<rf_pose> poses(size());
        check(rf_poses(handle_, poses.data(), poses.size()));
        return poses;
    }

    std::vector<rf_internal_pose> internal_poses() const {
        std::vector<rf_internal_pose> poses(size());
        check(rf_internal_poses(handle_, poses.data(), poses.size()));
        return poses;
    }

private:
    static std::size_t needed(const rf_config &config) {
        std::size_t bytes = 0;
        const rf_status status = rf_workspace_bytes(&config, &bytes);
        if (status != RF_OK) throw error(rf_detail{status, RF_NONE, RF_NONE, 0, 0, 0});
        return bytes;
    }

    void check(rf_status status) const {
        if (status == RF_OK) return;
        rf_detail detail{status, RF_NONE, RF_NONE, 0, 0, 0};
        rf_last_error_detail(handle_, &detail);
        throw error(detail);
    }

    aligned_bytes memory_;
    rf_simulator *handle_ = nullptr;
};

}  // namespace rigidformer
