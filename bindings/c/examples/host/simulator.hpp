// RigidFormer for C++17: owns its memory, throws what goes wrong.
#pragma once

#include <rigidformer.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>
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

// A unit to add: owns its points, which are in the unit's own reference frame.
class owned_unit {
public:
    owned_unit(std::vector<float> points, rf_physics physics)
        : points_(std::move(points)), physics_(physics) {
        if (points_.size() % 3 != 0) throw std::invalid_argument("a point has three coordinates");
    }

    // Goes where drive() sends it.
    owned_unit &driven() { return role(RF_ROLE_DRIVEN); }
    // Never moves.
    owned_unit &fixed() { return role(RF_ROLE_FIXED); }
    // Units of one body do not collide with each other.
    owned_unit &body(std::int32_t number) {
        body_ = number;
        return *this;
    }

    // Principal moments, kg m^2, through its centre along the axes of its points; otherwise those of the box around them.
    owned_unit &inertia(float x, float y, float z) {
        inertia_ = {x, y, z};
        return *this;
    }

    // Convex pieces that it touches with, where it is hollow: their points one piece after another, and how many each has.
    owned_unit &pieces(std::vector<float> points, std::vector<std::uint16_t> counts) {
        const auto sum = std::accumulate(counts.begin(), counts.end(), std::size_t{0});
        if (points.size() % 3 != 0 || points.size() / 3 != sum)
            throw std::invalid_argument("the counts of a unit's pieces must add up to their points");
        piece_points_ = std::move(points);
        piece_counts_ = std::move(counts);
        return *this;
    }

    // Refers to the points: valid while this unit lives.
    rf_unit unit() const {
        const auto [x, y, z] = inertia_;
        return {physics_, role_, body_, points_.data(), points_.size() / 3, {x, y, z},
                piece_points_.data(), piece_counts_.data(), piece_counts_.size()};
    }

private:
    owned_unit &role(std::uint32_t role) {
        role_ = role;
        return *this;
    }

    std::vector<float> points_;
    rf_physics physics_;
    std::uint32_t role_ = RF_ROLE_FREE;
    std::int32_t body_ = RF_OWN_BODY;
    std::array<float, 3> inertia_{};
    std::vector<float> piece_points_;
    std::vector<std::uint16_t> piece_counts_;
};

// A simulator; the model must outlive it. It may be moved: its memory stays where it is. Ends itself.
class simulator {
public:
    simulator(const std::uint8_t *model, std::size_t bytes, std::uint32_t max_units,
              std::uint32_t max_points)
        : simulator(rf_config{RF_ABI_VERSION, max_units, max_points, 0, model, bytes}) {}

    explicit simulator(const rf_config &config) : memory_(needed(config)) {
        rf_detail detail{};
        rf_simulator *handle = nullptr;
        if (rf_init(&config, memory_.data(), memory_.size(), &handle, &detail) != RF_OK)
            throw error(detail);
        handle_.reset(handle);
    }

    simulator(simulator &&) noexcept = default;
    // Not member by member: the handle must end before its memory does.
    simulator &operator=(simulator &&other) noexcept {
        simulator old(std::move(*this));
        memory_ = std::move(other.memory_);
        handle_ = std::move(other.handle_);
        return *this;
    }

    // Two frames of points, dt_s seconds apart.
    rf_observation observe(float dt_s, const rf_units &units, const float *previous,
                           const float *current) {
        rf_observation observation{};
        check(rf_observe(handle_.get(), dt_s, &units, previous, current, &observation));
        return observation;
    }

    // Where the points of a soft unit are, x, y, z in metres, in the order in which they were observed; by its number in ids().
    std::vector<float> soft_points(std::uint32_t unit) const {
        std::size_t count = 0;
        const rf_status status = rf_soft_points(handle_.get(), unit, nullptr, 0, &count);
        if (status != RF_ERROR_BUFFER) check(status);
        std::vector<float> points(3 * count);
        check(rf_soft_points(handle_.get(), unit, points.data(), count, &count));
        return points;
    }

    // Pairs of free units of one body that hold together from the next step on.
    void bond(const std::vector<std::array<rf_unit_id, 2>> &pairs) {
        const rf_unit_id *first = pairs.empty() ? nullptr : pairs.front().data();
        check(rf_bond(handle_.get(), first, pairs.size()));
    }

    // Whether the bond held until then.
    bool break_bond(rf_unit_id one, rf_unit_id other) {
        std::uint32_t held = 0;
        check(rf_break_bond(handle_.get(), one, other, &held));
        return held != 0;
    }

    // All bonds in the order in which they were made, and whether they hold.
    std::vector<rf_bonded> bonds() const {
        std::size_t count = 0;
        const rf_status status = rf_bonds(handle_.get(), nullptr, 0, &count);
        if (status != RF_ERROR_BUFFER) check(status);
        std::vector<rf_bonded> bonds(count);
        check(rf_bonds(handle_.get(), bonds.data(), bonds.size(), &count));
        return bonds;
    }

    // Two poses of each unit, dt_s seconds apart.
    void observe_poses(float dt_s, const rf_units &units, const float *points,
                       const rf_pose *previous, const rf_pose *current) {
        check(rf_observe_poses(handle_.get(), dt_s, &units, points, previous, current, nullptr));
    }

    // A unit more, that moved from one pose to the other in the last step.
    rf_unit_id add(const owned_unit &owned, const rf_pose &previous, const rf_pose &current) {
        const rf_unit unit = owned.unit();
        rf_unit_id id = 0;
        check(rf_add(handle_.get(), &unit, &previous, &current, &id));
        return id;
    }

    // A unit more, at rest.
    rf_unit_id add(const owned_unit &owned, const rf_pose &pose) { return add(owned, pose, pose); }

    void remove(rf_unit_id id) { check(rf_remove(handle_.get(), id)); }

    // Where a driven unit will be after the next step.
    void drive(rf_unit_id id, const rf_pose &pose) { check(rf_drive(handle_.get(), id, &pose)); }

    void set_poses(rf_unit_id id, const rf_pose &previous, const rf_pose &current) {
        check(rf_set_poses(handle_.get(), id, &previous, &current));
    }

    void set_physics(rf_unit_id id, const rf_physics &physics) {
        check(rf_set_physics(handle_.get(), id, &physics));
    }

    // RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED.
    void set_role(rf_unit_id id, std::uint32_t role) {
        check(rf_set_role(handle_.get(), id, role));
    }

    void set_planes(const std::vector<rf_plane> &planes) {
        check(rf_set_planes(handle_.get(), planes.data(), planes.size()));
    }

    void set_gravity(const std::array<float, 3> &gravity_m_s2) {
        check(rf_set_gravity(handle_.get(), gravity_m_s2.data()));
    }

    void set_dt(float dt_s) { check(rf_set_dt(handle_.get(), dt_s)); }

    void set_command(const std::vector<float> &numbers) {
        check(rf_set_command(handle_.get(), numbers.data(), numbers.size()));
    }

    rf_step_report step() {
        rf_step_report report{};
        check(rf_step(handle_.get(), &report));
        return report;
    }

    std::size_t size() const {
        std::uint32_t count = 0;
        check(rf_unit_count(handle_.get(), &count));
        return count;
    }

    // In the order of poses().
    std::vector<rf_unit_id> ids() const {
        std::vector<rf_unit_id> ids(size());
        check(rf_unit_ids(handle_.get(), ids.data(), ids.size()));
        return ids;
    }

    rf_pose pose(rf_unit_id id) const {
        rf_pose pose{};
        check(rf_unit_pose(handle_.get(), id, &pose));
        return pose;
    }

    std::vector<rf_pose> poses() const {
        std::vector<rf_pose> poses(size());
        check(rf_poses(handle_.get(), poses.data(), poses.size()));
        return poses;
    }

    std::vector<rf_internal_pose> internal_poses() const {
        std::vector<rf_internal_pose> poses(size());
        check(rf_internal_poses(handle_.get(), poses.data(), poses.size()));
        return poses;
    }

private:
    struct release {
        void operator()(rf_simulator *handle) const { rf_release(handle); }
    };

    static std::size_t needed(const rf_config &config) {
        std::size_t bytes = 0;
        const rf_status status = rf_workspace_bytes(&config, &bytes);
        if (status != RF_OK) throw error(rf_detail{status, RF_NONE, RF_NONE, 0, 0, 0});
        return bytes;
    }

    void check(rf_status status) const {
        if (status == RF_OK) return;
        rf_detail detail{status, RF_NONE, RF_NONE, 0, 0, 0};
        rf_last_error_detail(handle_.get(), &detail);
        throw error(detail);
    }

    // In this order: the handle ends first.
    aligned_bytes memory_;
    std::unique_ptr<rf_simulator, release> handle_;
};

}  // namespace rigidformer
