#include "match/internal/fft_correlator.h"

#include <fftw3.h>
#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdlib>
#include <mutex>
#include <new>
#include <numeric>
#include <opencv2/core.hpp>

namespace plumbline::internal {
namespace {

// FFTW's planner is not thread-safe; executing a plan on new arrays is.
std::mutex& PlannerMutex() {
  static std::mutex mutex;
  return mutex;
}

// Memory aligned as FFTW wants it.
template <typename T>
class Buffer {
 public:
  explicit Buffer(std::size_t size) : data_(static_cast<T*>(fftwf_malloc(size * sizeof(T)))) {
    if (data_ == nullptr) throw std::bad_alloc();
  }
  Buffer(Buffer&& other) noexcept : data_(std::exchange(other.data_, nullptr)) {}
  Buffer& operator=(Buffer&&) = delete;
  ~Buffer() { fftwf_free(data_); }
  T* get() const { return data_; }
  T& operator[](std::size_t i) const { return data_[i]; }

 private:
  T* data_;
};

using Complex = std::complex<float>;
fftwf_complex* Fftw(Complex* z) { return reinterpret_cast<fftwf_complex*>(z); }

// Forward and backward transform of real images of one size. FFTW_ESTIMATE: a measured plan, and
// with it the last bits, would differ from run to run.
class Transforms {
 public:
  Transforms(int rows, int columns)
      : rows_(rows), columns_(columns), complex_columns_(columns / 2 + 1) {
    const Buffer<float> real(real_count());
    const Buffer<Complex> complex(complex_count());
    const std::lock_guard lock(PlannerMutex());
    forward_ = fftwf_plan_dft_r2c_2d(rows, columns, real.get(), Fftw(complex.get()), FFTW_ESTIMATE);
    backward_ =
        fftwf_plan_dft_c2r_2d(rows, columns, Fftw(complex.get()), real.get(), FFTW_ESTIMATE);
  }
  Transforms(const Transforms&) = delete;
  Transforms& operator=(const Transforms&) = delete;
  ~Transforms() {
    const std::lock_guard lock(PlannerMutex());
    fftwf_destroy_plan(forward_);
    fftwf_destroy_plan(backward_);
  }
  std::size_t real_count() const {
    return static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_);
  }
  std::size_t complex_count() const {
    return static_cast<std::size_t>(rows_) * static_cast<std::size_t>(complex_columns_);
  }
  int columns() const { return columns_; }
  void Forward(const Buffer<float>& from, const Buffer<Complex>& to) const {
    fftwf_execute_dft_r2c(forward_, from.get(), Fftw(to.get()));
  }
  void Backward(const Buffer<Complex>& from, const Buffer<float>& to) const {
    fftwf_execute_dft_c2r(backward_, Fftw(from.get()), to.get());
  }

 private:
  int rows_, columns_, complex_columns_;
  fftwf_plan forward_ = nullptr, backward_ = nullptr;
};

struct Workspace {
  explicit Workspace(const Transforms& transforms)
      : subset(transforms.real_count()),
        product(transforms.real_count()),
        sum(transforms.real_count()),
        square(transforms.real_count()),
        spectrum(transforms.complex_count()),
        scratch(transforms.complex_count()) {
    std::fill_n(subset.get(), transforms.real_count(), 0.0F);
  }
  Buffer<float> subset;  // 0 but for the first rows and columns, which every template fills
  Buffer<float> product, sum, square;
  Buffer<Complex> spectrum, scratch;
};

}  // namespace

struct FftCorrelator::State {
  State(const Image<float>& deformed, int radius);

  void Correlate(const std::vector<float>& subset, bool with_squares, Workspace* work) const;
  void Zncc(const SubsetTemplate& subset, Workspace* work) const;

  ImageSize size;
  int side;
  Transforms transforms;
  Buffer<Complex> grey, square;  // spectra of the image less its mean, and of the square of that
  Image<float> norm;  // root of the summed squares about the mean of the window from here
  mutable tbb::enumerable_thread_specific<Workspace> workspaces{
      [this] { return Workspace(transforms); }};
};

FftCorrelator::State::State(const Image<float>& deformed, int radius)
    : size(deformed.size()),
      side(2 * radius + 1),
      transforms(cv::getOptimalDFTSize(size.height), cv::getOptimalDFTSize(size.width)),
      grey(transforms.complex_count()),
      square(transforms.complex_count()),
      norm({std::max(0, size.width - side + 1), std::max(0, size.height - side + 1)}) {
  const double mean = std::accumulate(deformed.values().begin(), deformed.values().end(), 0.0) /
                      static_cast<double>(deformed.pixel_count());
  Buffer<float> padded(transforms.real_count()), squares(transforms.real_count());
  std::fill_n(padded.get(), transforms.real_count(), 0.0F);
  std::fill_n(squares.get(), transforms.real_count(), 0.0F);
  // Sums over all pixels above and to the left.
  Image<double> sums({size.width + 1, size.height + 1}, 0), square_sums(sums);
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      const double g = static_cast<double>(deformed(y, x)) - mean;
      const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(transforms.columns()) +
                     static_cast<std::size_t>(x);
      padded[i] = static_cast<float>(g);
      squares[i] = static_cast<float>(g * g);
      sums(y + 1, x + 1) = g + sums(y, x + 1) + sums(y + 1, x) - sums(y, x);
      square_sums(y + 1, x + 1) =
          g * g + square_sums(y, x + 1) + square_sums(y + 1, x) - square_sums(y, x);
    }
  }
  transforms.Forward(padded, grey);
  transforms.Forward(squares, square);
  const auto over = [this](const Image<double>& s, int y, int x) {
    return s(y + side, x + side) - s(y, x + side) - s(y + side, x) + s(y, x);
  };
  for (int y = 0; y < norm.height(); ++y) {
    for (int x = 0; x < norm.width(); ++x) {
      const double s = over(sums, y, x);
      norm(y, x) = static_cast<float>(
          std::sqrt(std::max(0.0, over(square_sums, y, x) - s * s / (side * side))));
    }
  }
}

// Correlation of a template with the image (into work->product, or work->sum when with_squares) and
// with its square.
void FftCorrelator::State::Correlate(const std::vector<float>& subset, bool with_squares,
                                     Workspace* work) const {
  for (int i = 0; i < side; ++i) {
    std::copy_n(&subset[static_cast<std::size_t>(i * side)], side,
                work->subset.get() + static_cast<std::ptrdiff_t>(i) * transforms.columns());
  }
  transforms.Forward(work->subset, work->spectrum);
  const auto with = [&](const Buffer<Complex>& image, const Buffer<float>& out) {
    const float scale = 1.0F / static_cast<float>(transforms.real_count());
    for (std::size_t k = 0; k < transforms.complex_count(); ++k) {
      const Complex t = work->spectrum[k], g = image[k];
      // conj(t) g by hand: the library's product looks for infinities.
      work->scratch[k] = {scale * (t.real() * g.real() + t.imag() * g.imag()),
                          scale * (t.real() * g.imag() - t.imag() * g.real())};
    }
    transforms.Backward(work->scratch, out);
  };
  with(grey, with_squares ? work->sum : work->product);
  if (with_squares) with(square, work->square);
}

// The ZNCC of every place, into work->product; -2 where the window has no contrast.
void FftCorrelator::State::Zncc(const SubsetTemplate& subset, Workspace* work) const {
  Correlate(subset.value, false, work);
  if (!subset.weight.empty()) Correlate(subset.weight, true, work);
  const auto least = static_cast<float>(kLeastContrastShare * subset.norm);
  const auto template_norm = static_cast<float>(subset.norm);
  for (int y = 0; y < norm.height(); ++y) {
    const auto at = static_cast<std::size_t>(y) * static_cast<std::size_t>(transforms.columns());
    for (int x = 0; x < norm.width(); ++x) {
      const auto i = at + static_cast<std::size_t>(x);
      float window = norm(y, x);
      if (!subset.weight.empty()) {
        const float s = work->sum[i];
        window =
            std::sqrt(std::max(0.0F, work->square[i] - s * s / static_cast<float>(subset.count)));
      }
      work->product[i] = window < least ? -2.0F : work->product[i] / (window * template_norm);
    }
  }
}

FftCorrelator::FftCorrelator(const Image<float>& deformed, int radius_px)
    : state_(std::make_unique<State>(deformed, radius_px)) {}
FftCorrelator::~FftCorrelator() = default;

std::optional<FftPeak> FftCorrelator::Find(const SubsetTemplate& subset, int search_px) const {
  Workspace& work = state_->workspaces.local();
  state_->Zncc(subset, &work);
  const ImageSize places = state_->norm.size();
  const auto zncc = [&](int y, int x) {
    return work.product[static_cast<std::size_t>(y) *
                            static_cast<std::size_t>(state_->transforms.columns()) +
                        static_cast<std::size_t>(x)];
  };
  const Eigen::Vector2i still = subset.centre_px.array() - subset.radius_px;
  const int reach = search_px > 0 ? search_px : std::max(places.width, places.height);
  const int x0 = std::max(0, still.x() - reach), x1 = std::min(places.width - 1, still.x() + reach);
  const int y0 = std::max(0, still.y() - reach),
            y1 = std::min(places.height - 1, still.y() + reach);
  const auto best_beyond = [&](const Eigen::Vector2i& place, int exclusion) {
    Eigen::Vector2i best(-1, -1);
    for (int y = y0; y <= y1; ++y) {
      const bool near_row = std::abs(y - place.y()) <= exclusion;
      for (int x = x0; x <= x1; ++x) {
        if (near_row && std::abs(x - place.x()) <= exclusion) continue;
        if (zncc(y, x) > (best.x() < 0 ? -2.0F : zncc(best.y(), best.x()))) best = {x, y};
      }
    }
    return best;
  };
  const Eigen::Vector2i best = best_beyond({0, 0}, -1);
  // A maximum on the border of the window may go on beyond it.
  if (best.x() <= x0 || best.y() <= y0 || best.x() >= x1 || best.y() >= y1) return std::nullopt;
  const Eigen::Vector2i second = best_beyond(best, std::max(3, subset.radius_px / 2));
  const auto value = [&](int y, int x) { return static_cast<double>(zncc(y, x)); };
  FftPeak peak;
  peak.displacement_px = (best - still).cast<double>();
  peak.zncc = value(best.y(), best.x());
  peak.second_zncc = second.x() < 0 ? 0 : std::max(0.0, value(second.y(), second.x()));
  peak.displacement_px.x() +=
      ParabolaPeak(value(best.y(), best.x() - 1), peak.zncc, value(best.y(), best.x() + 1));
  peak.displacement_px.y() +=
      ParabolaPeak(value(best.y() - 1, best.x()), peak.zncc, value(best.y() + 1, best.x()));
  return peak;
}

}  // namespace plumbline::internal
