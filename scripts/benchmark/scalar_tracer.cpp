// The plain bench, written by hand for one photon at a time: what our transport has to beat.
//
// Unpolarised light, isotropic scattering, polished faces; the geometry is that of
// scenes/camoo4.xml: crystal |x|, |y| <= W/2, 0 <= z <= H; gap of the same footprint, -g <= z <= 0;
// window plate below it; black mask with a round hole on the plate's entrance face, z = -g; the
// plate's back face detects.
//
//     scalar_tracer NAME=VALUE ...        prints one JSON object
//
// Names are those of the scene's parameters (lengths in mm, coefficients in 1/cm), and photons,
// seed, threads and unfold: 1 takes light that total reflection traps to its next scattering at
// once. The same seed and photons give the same result on any number of threads.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <iterator>
#include <map>
#include <string>
#include <thread>
#include <vector>

namespace {

// Single precision is a twentieth faster. Its rounding, 1e-6 mm on this bench, changes eta by 2e-6
// of it.
using Real = float;

constexpr Real kMmPerCm = 10;
// Absorption takes weight down to this, and whole photons from there on: a tenth sooner to equal
// error at the gel than whole photons from birth, and the same in air.
constexpr Real kLowestWeightDepth = 1.2f;  // 30 %, as an optical depth
constexpr Real kForever = 1e30f;
// Light that total reflection traps in a clear crystal ends after so many flights in it.
constexpr int kMostFlights = 10000;
// Added to what may be 0 exactly, and too small to change any other number that is drawn: a flight
// along a plane in which it is would give 0 times infinity.
constexpr Real kNotZero = 0x1p-33f;
// Photons that share a random sequence; threads take such portions one after the other.
constexpr std::uint64_t kPortion = 16384;

enum Fate { kDetected, kAbsorbedCrystal, kAbsorbedAperture, kEscaped, kTruncated, kFates };
constexpr const char* kFateNames[] = {"detected", "absorbed_crystal", "absorbed_aperture",
                                      "escaped", "truncated"};

struct Bench {
  Real half_crystal, height, half_window, thickness, gap, aperture_squared;
  Real n_crystal, n_gap, n_window, scattering_per_mm, absorption_per_mm;
  // Below these cosines of incidence on sides and top, and on the bottom, light is trapped; 0 where
  // trapped light is followed from face to face.
  Real trapped_cosine_to_air, trapped_cosine_to_gap;
};

// xoshiro256+ of D. Blackman and S. Vigna, seeded by their splitmix64.
class Random {
 public:
  Random(std::uint64_t seed, std::uint64_t portion) {
    std::uint64_t key = seed * 0xd1342543de82ef95u + portion;
    for (auto& word : state_) {
      std::uint64_t z = key += 0x9e3779b97f4a7c15u;
      z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
      z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
      word = z ^ (z >> 31);
    }
  }
  // From 0 to below 1: the upper 24 of 64 bits, all that a float can hold.
  Real uniform() { return Real(next() >> 40) * 0x1p-24f; }
  // Two numbers from -1 to 1, never 0, of one draw.
  void signed_pair(Real& u, Real& v) {
    const std::uint64_t bits = next();
    u = Real(std::int32_t(bits >> 32)) * 0x1p-31f + kNotZero;
    v = Real(std::int32_t(std::uint32_t(bits))) * 0x1p-31f + kNotZero;
  }
  // Of mean 1. Half a step keeps the logarithm finite.
  Real exponential() { return -std::log(uniform() + 0x1p-25f); }

 private:
  std::uint64_t next() {
    const std::uint64_t result = state_[0] + state_[3], shifted = state_[1] << 17;
    state_[2] ^= state_[0];
    state_[3] ^= state_[1];
    state_[1] ^= state_[2];
    state_[0] ^= state_[3];
    state_[2] ^= shifted;
    state_[3] = (state_[3] << 45) | (state_[3] >> 19);
    return result;
  }
  std::uint64_t state_[4];
};

struct Tally {
  double fates[kFates] = {}, detected_squared = 0;
};

// A photon's flight from birth to fate.
class Photon {
 public:
  Photon(const Bench& bench, Random& random) : bench_(bench), random_(random) {}

  void follow(Tally& tally) {
    random_.signed_pair(at_[0], at_[1]);
    at_[0] *= bench_.half_crystal;
    at_[1] *= bench_.half_crystal;
    at_[2] = random_.uniform() * bench_.height;
    scatter();
    const Real absorption_per_mm = bench_.absorption_per_mm;
    const Real by_weight_mm =
        absorption_per_mm > 0 ? kLowestWeightDepth / absorption_per_mm : kForever;
    const Real life_mm =
        absorption_per_mm > 0 ? by_weight_mm + random_.exponential() / absorption_per_mm : kForever;
    to_absorption_mm_ = life_mm;
    flights_ = 0;
    Region region = kCrystal;
    while (region < kEnd)
      region = region == kCrystal ? cross_crystal() : region == kGap ? cross_gap() : cross_window();
    const Real path_mm = std::min(life_mm - to_absorption_mm_, by_weight_mm);
    const double weight = std::exp(-absorption_per_mm * path_mm);
    tally.fates[fate_] += weight;
    tally.fates[kAbsorbedCrystal] += 1 - weight;
    if (fate_ == kDetected) tally.detected_squared += weight * weight;
  }

 private:
  // Regions whose flights are followed; what leaves them for the air is settled at once.
  enum Region { kCrystal, kGap, kWindow, kEnd };

  Region end(Fate fate) {
    fate_ = fate;
    return kEnd;
  }

  // A new direction, uniform over the sphere (G. Marsaglia, 1972), and the path to the next one.
  void scatter() {
    Real u, v, s;
    do {
      random_.signed_pair(u, v);
      s = u * u + v * v;
    } while (s >= 1);
    const Real r = 2 * std::sqrt(1 - s);
    towards(r * u, r * v, 1 - 2 * s + kNotZero);
    to_scattering_mm_ =
        bench_.scattering_per_mm > 0 ? random_.exponential() / bench_.scattering_per_mm : kForever;
  }

  // Faces are along the axes, so reflections change signs only: the divisions are done here.
  void towards(Real x, Real y, Real z) {
    direction_[0] = x, direction_[1] = y, direction_[2] = z;
    for (int axis = 0; axis < 3; ++axis) inverse_[axis] = 1 / direction_[axis];
  }

  // Arrays are indexed by constants here and below, which keeps them in registers: a fifth faster.
  void reflect(int axis) {
    for (int i = 0; i < 3; ++i) {
      direction_[i] = axis == i ? -direction_[i] : direction_[i];
      inverse_[i] = axis == i ? -inverse_[i] : inverse_[i];
    }
  }

  // Fly so far, or to where a box ends if that is nearer: |x|, |y| <= half, low <= z <= high.
  // Returns the axis of the face that is met, or -1.
  int fly(Real half, Real low, Real high, Real& distance) {
    const Real face[3] = {std::copysign(half, direction_[0]), std::copysign(half, direction_[1]),
                          direction_[2] > 0 ? high : low};
    Real t[3];
    for (int i = 0; i < 3; ++i) t[i] = (face[i] - at_[i]) * inverse_[i];
    int axis = t[0] < t[1] ? 0 : 1;
    Real nearest = std::min(t[0], t[1]);
    axis = t[2] < nearest ? 2 : axis;
    nearest = std::max(std::min(t[2], nearest), Real(0));
    axis = nearest < distance ? axis : -1;
    distance = std::min(nearest, distance);
    // exactly onto the face, which the next region shares
    for (int i = 0; i < 3; ++i)
      at_[i] = axis == i ? face[i] : at_[i] + distance * direction_[i];
    return axis;
  }

  // Where 0 <= x <= width ends a flight that it reflects at both ends.
  static Real folded(Real x, Real width) {
    x -= 2 * width * std::floor(x / (2 * width));
    return x > width ? 2 * width - x : x;
  }

  bool trapped() const {
    const Real x = std::abs(direction_[0]), y = std::abs(direction_[1]);
    return std::max(x, y) < bench_.trapped_cosine_to_air &&
           std::abs(direction_[2]) < bench_.trapped_cosine_to_gap;
  }

  // Fresnel's formulae for unpolarised light (M. Born and E. Wolf, 1.5.2 and 1.5.3). The photon is
  // turned into the new medium (true), or left as it is, for the caller to `reflect`.
  bool refract(int axis, Real n_in, Real n_out) {
    if (n_in == n_out) return true;
    const Real ratio = n_in / n_out;
    const Real cos_in =
        std::abs(axis == 0 ? direction_[0] : axis == 1 ? direction_[1] : direction_[2]);
    const Real squared = 1 - ratio * ratio * (1 - cos_in * cos_in);
    if (squared <= 0) return false;
    const Real cos_out = std::sqrt(squared);
    const Real s_in = n_in * cos_in, s_out = n_out * cos_out;
    const Real p_in = n_out * cos_in, p_out = n_in * cos_out;
    // (s- / s+)^2 + (p- / p+)^2 over one denominator
    const Real s_plus = s_in + s_out, p_plus = p_in + p_out;
    const Real a = (s_in - s_out) * p_plus, b = (p_in - p_out) * s_plus, c = s_plus * p_plus;
    if (2 * random_.uniform() * c * c < a * a + b * b) return false;
    Real d[3];
    for (int i = 0; i < 3; ++i)
      d[i] = axis == i ? std::copysign(cos_out, direction_[i]) : ratio * direction_[i];
    towards(d[0], d[1], d[2]);
    return true;
  }

  bool masked() const { return at_[0] * at_[0] + at_[1] * at_[1] > bench_.aperture_squared; }
  bool under_crystal() const {
    return std::max(std::abs(at_[0]), std::abs(at_[1])) <= bench_.half_crystal;
  }

  Region cross_crystal() {
    for (; flights_ < kMostFlights; ++flights_) {
      Real distance = std::min(to_scattering_mm_, to_absorption_mm_);
      int axis = -1;
      if (trapped() && distance < kForever) {
        // all reflections until then are total; the direction is not needed any more
        const Real half = bench_.half_crystal;
        for (int i = 0; i < 2; ++i)
          at_[i] = folded(at_[i] + half + distance * direction_[i], 2 * half) - half;
        at_[2] = folded(at_[2] + distance * direction_[2], bench_.height);
      } else {
        axis = fly(bench_.half_crystal, 0, bench_.height, distance);
      }
      to_scattering_mm_ -= distance;
      to_absorption_mm_ -= distance;
      if (axis < 0) {
        if (to_absorption_mm_ <= 0) return end(kAbsorbedCrystal);
        scatter();
        continue;
      }
      const bool to_gap = axis == 2 && direction_[2] < 0;
      if (refract(axis, bench_.n_crystal, to_gap ? bench_.n_gap : 1))
        return to_gap ? kGap : from_side();
      reflect(axis);
    }
    return end(kTruncated);
  }

  Region cross_gap() {
    for (;;) {
      Real distance = kForever;
      const int axis = fly(bench_.half_crystal, -bench_.gap, 0, distance);
      if (axis < 2) {
        if (refract(axis, bench_.n_gap, 1)) return from_side();
      } else if (direction_[2] > 0) {
        if (refract(axis, bench_.n_gap, bench_.n_crystal)) return kCrystal;
      } else {
        if (masked()) return end(kAbsorbedAperture);
        if (refract(axis, bench_.n_gap, bench_.n_window)) return kWindow;
      }
      reflect(axis);
    }
  }

  Region cross_window() {
    for (;;) {
      Real distance = kForever;
      const Real top = -bench_.gap;
      const int axis = fly(bench_.half_window, top - bench_.thickness, top, distance);
      if (axis < 2) {
        // what has left by an edge moves away from all bodies
        if (refract(axis, bench_.n_window, 1)) return end(kEscaped);
      } else if (direction_[2] < 0) {
        return end(kDetected);
      } else {
        if (masked()) return end(kAbsorbedAperture);
        const bool to_gap = under_crystal();
        if (refract(axis, bench_.n_window, to_gap ? bench_.n_gap : 1))
          return to_gap ? kGap : from_window();
      }
      reflect(axis);
    }
  }

  // In air, out of a side (or the top) of crystal or gap, and moving away from both: only the
  // plate's entrance face can be met, and what it reflects is gone.
  Region from_side() {
    if (direction_[2] >= 0) return end(kEscaped);
    const Real t = (-bench_.gap - at_[2]) * inverse_[2];
    for (int i = 0; i < 2; ++i) at_[i] += t * direction_[i];
    at_[2] = -bench_.gap;
    if (std::max(std::abs(at_[0]), std::abs(at_[1])) > bench_.half_window) return end(kEscaped);
    if (masked()) return end(kAbsorbedAperture);
    return refract(2, 1, bench_.n_window) ? kWindow : end(kEscaped);
  }

  // In air, up from the plate: to a side of the box that crystal and gap are together, if any. What
  // is reflected there moves up and away.
  Region from_window() {
    const Real half = bench_.half_crystal;
    Real enters[2], leaves = kForever;
    for (int i = 0; i < 2; ++i) {
      const Real middle = -at_[i] * inverse_[i], reach = std::abs(half * inverse_[i]);
      enters[i] = middle - reach;
      leaves = std::min(leaves, middle + reach);
    }
    const int axis = enters[0] > enters[1] ? 0 : 1;
    const Real t = std::max(enters[axis], Real(0)), z = at_[2] + t * direction_[2];
    if (t >= leaves || z >= bench_.height) return end(kEscaped);
    at_[1 - axis] += t * direction_[1 - axis];
    at_[axis] = -std::copysign(half, direction_[axis]);
    at_[2] = z;
    const Region side = z > 0 ? kCrystal : kGap;
    const Real index = side == kCrystal ? bench_.n_crystal : bench_.n_gap;
    return refract(axis, 1, index) ? side : end(kEscaped);
  }

  const Bench& bench_;
  Random& random_;
  Real at_[3], direction_[3], inverse_[3];
  Real to_scattering_mm_, to_absorption_mm_;  // of path in the crystal
  int flights_;                               // in the crystal
  Fate fate_;
};

}  // namespace

int main(int count, char** arguments) {
  std::map<std::string, double> given;
  for (int i = 1; i < count; ++i) {
    const std::string argument = arguments[i];
    const auto equals = argument.find('=');
    given[argument.substr(0, equals)] = std::atof(argument.c_str() + equals + 1);
  }
  const auto real = [&given](const char* name) { return Real(given.at(name)); };
  const auto trapped_cosine = [&](Real n_outside) {
    const Real sine = n_outside / real("n_crystal");
    return real("unfold") * std::sqrt(std::max(1 - sine * sine, Real(0)));
  };
  const Bench bench{real("crystal_width_mm") / 2, real("crystal_height_mm"),
                    real("window_width_mm") / 2, real("window_thickness_mm"), real("gap_mm"),
                    real("aperture_radius_mm") * real("aperture_radius_mm"), real("n_crystal"),
                    real("n_gap"), real("n_window"), real("alpha_scat_per_cm") / kMmPerCm,
                    real("alpha_abs_per_cm") / kMmPerCm, trapped_cosine(1),
                    trapped_cosine(real("n_gap"))};
  const auto photons = std::uint64_t(given.at("photons")), seed = std::uint64_t(given.at("seed"));

  const auto begin = std::chrono::steady_clock::now();
  std::vector<Tally> tallies((photons + kPortion - 1) / kPortion);
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t portion; (portion = next++) < tallies.size();) {
      Random random(seed, portion);
      Photon photon(bench, random);
      Tally tally;
      for (auto left = std::min(kPortion, photons - portion * kPortion); left; --left)
        photon.follow(tally);
      tallies[portion] = tally;
    }
  };
  std::vector<std::thread> threads(std::size_t(given.at("threads")));
  for (auto& thread : threads) thread = std::thread(work);
  for (auto& thread : threads) thread.join();
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - begin;

  Tally all;
  for (const auto& tally : tallies) {
    for (int fate = 0; fate < kFates; ++fate) all.fates[fate] += tally.fates[fate];
    all.detected_squared += tally.detected_squared;
  }
  const double n = double(photons), eta = all.fates[kDetected] / n;
  const double sigma = std::sqrt((all.detected_squared / n - eta * eta) / n);
  std::printf("{\"eta\": %.9g, \"eta_sigma\": %.3g, \"fates\": {", eta, sigma);
  for (int fate = 0; fate < kFates; ++fate)
    std::printf("%s\"%s\": %.9g", fate ? ", " : "", kFateNames[fate], all.fates[fate] / n);
  std::printf("}, \"photons\": %llu, \"seconds\": %.6f, \"processor_s\": %.6f, "
              "\"photons_per_second\": %.6g}\n",
              static_cast<unsigned long long>(photons), seconds.count(),
              double(std::clock()) / CLOCKS_PER_SEC, n / seconds.count());
}
