// Depth of a photo without Python, the same as that of `depthcli predict --upsample bilinear`.
//
//   depth MODEL IMAGE.ppm DEPTH.pgm [HFOV]
//
// MODEL is the folder of a bundled model (card.json and model.onnx), the image an 8-bit PPM or PGM,
// HFOV its horizontal field of view in degrees. DEPTH.pgm has 16 bits: millimetres.
// Left out: guided upsampling (sharper edges) and the padding of images longer than 2:1.
#include <onnxruntime_cxx_api.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

struct Plane {
  int width, height;
  std::vector<float> values;
  Plane(int w, int h) : width(w), height(h), values(size_t(w) * h) {}
};

// The number, or the first of a list, after a key in a section of the card.
double number(const std::string& card, const std::string& section, const std::string& key) {
  size_t place = card.find('"' + section + "\": {");
  if (place != std::string::npos) place = card.find('"' + key + "\":", place);
  if (place == std::string::npos) throw std::runtime_error("the card has no " + section + "." + key);
  return std::stod(card.substr(card.find_first_of("-0123456789", place + key.size() + 2)));
}

// V of HSV, the largest of red, green and blue, from 0 to 1.
Plane read_image(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string kind;
  int width = 0, height = 0, top = 0;
  file >> kind >> width >> height >> top;
  if ((kind != "P5" && kind != "P6") || top != 255 || width < 1 || height < 1)
    throw std::runtime_error(path + " is no 8-bit PGM or PPM: convert it (ffmpeg -i a.jpg a.ppm)");
  file.get();
  Plane image(width, height);
  std::vector<char> pixel(kind == "P6" ? 3 : 1);
  for (float& value : image.values) {
    if (!file.read(pixel.data(), pixel.size())) throw std::runtime_error(path + " is cut off");
    for (char level : pixel) value = std::max(value, uint8_t(level) / 255.f);
  }
  return image;
}

// Along the rows, which are then columns: the mean of what a pixel covers where the axis shrinks and
// is_area, else linear with half-pixel centres.
Plane resize_rows(const Plane& image, int width, bool is_area) {
  Plane result(image.height, width);
  const double step = double(image.width) / width;
  for (int x = 0; x < width; ++x) {
    double start = x * step, end = std::min<double>(start + step, image.width), share = 0;
    const bool is_mean = is_area && step > 1;
    if (!is_mean) {
      const double place = std::clamp((x + 0.5) * step - 0.5, 0., image.width - 1.);
      share = place - std::floor(place);
      start = std::floor(place);
      end = start + (share > 0 ? 2 : 1);
    }
    for (int from = int(start); from < end; ++from) {
      const double overlap = std::min(from + 1., end) - std::max<double>(from, start);
      const float weight = is_mean ? overlap / step : from == int(start) ? 1 - share : share;
      for (int y = 0; y < image.height; ++y)
        result.values[size_t(x) * image.height + y] +=
            weight * image.values[size_t(y) * image.width + from];
    }
  }
  return result;
}

Plane resize(const Plane& image, int width, int height, bool is_area = false) {
  return resize_rows(resize_rows(image, width, is_area), height, is_area);
}

void run(const std::string& model, const std::string& source, const std::string& target, double hfov) {
  std::ifstream file(model + "/card.json");
  const std::string card(std::istreambuf_iterator<char>(file), {});
  auto in = [&](const char* key) { return number(card, "input", key); };
  auto out = [&](const char* key) { return number(card, "output", key); };
  const Plane image = read_image(source);

  // The aspect of the image at the number of pixels that the network was trained with.
  const double area = in("width") * in("height"), aspect = double(image.width) / image.height;
  const int step = int(in("multiple_of"));
  auto side = [&](double px) { return std::max(step, int(std::lround(px / step)) * step); };
  Plane input = resize(image, side(std::sqrt(area * aspect)), side(std::sqrt(area / aspect)), true);
  for (float& value : input.values) value = (value - in("mean")) / in("std");

  Ort::Env env(ORT_LOGGING_LEVEL_WARNING, "depth");
  Ort::Session session(env, (model + "/model.onnx").c_str(), Ort::SessionOptions{});
  Ort::AllocatorWithDefaultOptions allocator;
  const auto input_name = session.GetInputNameAllocated(0, allocator);
  const auto output_name = session.GetOutputNameAllocated(0, allocator);
  const std::array<const char*, 1> inputs{input_name.get()}, outputs{output_name.get()};
  const std::array<int64_t, 4> shape{1, 1, input.height, input.width};
  const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  const auto tensor = Ort::Value::CreateTensor<float>(
      memory, input.values.data(), input.values.size(), shape.data(), shape.size());
  const auto results = session.Run({}, inputs.data(), &tensor, 1, outputs.data(), 1);
  const auto raw_shape = results[0].GetTensorTypeAndShapeInfo().GetShape();
  const float* raw = results[0].GetTensorData<float>();
  Plane coarse(int(raw_shape[raw_shape.size() - 1]), int(raw_shape[raw_shape.size() - 2]));
  const double scale = out("scale"), shift = out("shift");
  for (float& depth_m : coarse.values) depth_m = std::exp(scale * *raw++ + shift);

  // The focal length over that of the training camera, both in pixels of the network's input; the
  // image is by default the largest crop of that camera's.
  auto focal_px = [](double deg, double width) { return width / 2 / std::tan(deg * M_PI / 360); };
  const double trained_px = focal_px(number(card, "camera", "hfov_deg"), in("width"));
  const auto [small, large] = std::minmax({image.width, image.height});
  const auto [least, most] = std::minmax({in("width"), in("height")});
  const double px = hfov > 0 ? focal_px(hfov, image.width)
                             : trained_px * std::max(small / least, large / most);
  const double zoom = std::sqrt(double(input.width) / image.width * input.height / image.height);
  const double factor = std::pow(px * zoom / trained_px, number(card, "camera", "exponent"));

  std::ofstream result(target, std::ios::binary);
  result << "P5\n" << image.width << ' ' << image.height << "\n65535\n";
  const double min_m = out("min_m"), max_m = out("max_m");
  for (float depth_m : resize(coarse, image.width, image.height).values) {
    const double mm = 1000 * factor * std::clamp<double>(depth_m, min_m, max_m);
    const auto level = uint16_t(std::lround(std::min(mm, 65535.)));
    result.put(char(level >> 8)).put(char(level & 255));
  }
  if (!result.flush()) throw std::runtime_error(target + " cannot be written");
}

int main(int count, char** words) try {
  if (count < 4) throw std::runtime_error("usage: depth MODEL IMAGE.ppm DEPTH.pgm [HFOV]");
  run(words[1], words[2], words[3], count > 4 ? std::stod(words[4]) : 0);
} catch (const std::exception& error) {
  std::cerr << error.what() << '\n';
  return 1;
}
