// Pieces of parts on their way through the coordinator.

#include "coordinator/artifacts/relay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <thread>

#include "scene/model/error.h"
#include "tests/farm/fake_frame.h"

namespace gleaner::coordinator {
namespace {

using testing::HasSubstr;

constexpr WorkerId holder = 3;

PartRange range(std::uint64_t offset, std::uint64_t length = 100) {
  return {std::string(64, 'a'), 0, std::string(32, 'd'), false, offset, length};
}

std::string message_of(const std::function<void()>& call, ErrorKind kind = ErrorKind::connection) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind);
    return error.what();
  }
  return "no error";
}

TEST(Relay, BytesArriveWithWhoWaits) {
  Relay relay;
  std::uint64_t asked = 0;
  auto piece = relay.begin(holder, range(0), [&](std::uint64_t request) {
    asked = request;
    return true;
  });
  EXPECT_TRUE(relay.deliver(holder, asked, std::string(100, 'x'), ""));
  EXPECT_EQ(relay.wait(piece), std::string(100, 'x'));
  EXPECT_FALSE(relay.deliver(holder, asked, std::string(100, 'y'), "")) << "answered already";
  EXPECT_EQ(relay.delivered_bytes(), 100u);
}

TEST(Relay, TwentyReadersOfAPieceAskForItOnce) {
  Relay relay;
  std::atomic<int> asks{0};
  std::atomic<std::uint64_t> request{0};
  std::atomic<int> right{0}, begun{0};
  std::vector<std::thread> readers;
  for (int i = 0; i < 20; ++i)
    readers.emplace_back([&] {
      auto piece = relay.begin(holder, range(0), [&](std::uint64_t number) {
        ++asks;
        request = number;
        return true;
      });
      ++begun;
      right += relay.wait(piece) == std::string(100, 'x');
    });
  ASSERT_TRUE(test::eventually([&] { return begun == 20; }));
  relay.deliver(holder, request, std::string(100, 'x'), "");
  for (auto& reader : readers) reader.join();
  EXPECT_EQ(asks, 1);
  EXPECT_EQ(right, 20);
}

TEST(Relay, TakesNoMoreMemoryThanItsBound) {
  Relay relay(250, 0.1);
  const auto yes = [](std::uint64_t) { return true; };
  auto first = relay.begin(holder, range(0), yes), second = relay.begin(holder, range(100), yes);
  EXPECT_THAT(message_of([&] { relay.begin(holder, range(200), yes); }), HasSubstr("too many"));
  auto waits = std::async(std::launch::async, [&] { return relay.begin(holder, range(200), yes) != nullptr; });
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  first.reset();  // nobody reads it any more
  EXPECT_TRUE(waits.get());
  second.reset();
  EXPECT_TRUE(relay.begin(holder, range(0, 10000), yes)) << "one alone always may";
}

TEST(Relay, WhatDoesNotArriveIsAnErrorAndCanBeAskedForAgain) {
  Relay relay(1 << 20, 0.1);
  std::uint64_t asked = 0;
  const auto ask = [&](std::uint64_t request) {
    asked = request;
    return true;
  };
  EXPECT_THAT(message_of([&] { relay.wait(relay.begin(holder, range(0), ask)); }), HasSubstr("does not answer"));
  EXPECT_FALSE(relay.deliver(holder, asked, std::string(100, 'x'), "")) << "too late";
  struct {
    const char* what;
    std::function<void()> happens;
    const char* message;
    ErrorKind kind;  // failed: the holder has no such bytes
  } const cases[] = {
      {"an error", [&] { relay.deliver(holder, asked, "", "the disk is gone"); }, "the disk is gone",
       ErrorKind::failed},
      {"too few bytes", [&] { relay.deliver(holder, asked, std::string(99, 'x'), ""); }, "99 bytes instead of 100",
       ErrorKind::failed},
      {"too many bytes", [&] { relay.deliver(holder, asked, std::string(101, 'x'), ""); }, "101 bytes instead of 100",
       ErrorKind::failed},
      {"the holder goes", [&] { relay.worker_lost(holder); }, "gone", ErrorKind::connection},
  };
  for (const auto& [what, happens, message, kind] : cases) {
    auto piece = relay.begin(holder, range(0), ask);
    EXPECT_FALSE(relay.deliver(holder + 1, asked, std::string(100, 'x'), "")) << "from another worker";
    EXPECT_FALSE(relay.deliver(holder, asked + 1, std::string(100, 'x'), "")) << "a number that was never given";
    relay.worker_lost(holder + 1);
    happens();
    EXPECT_THAT(message_of([&] { relay.wait(piece); }, kind), HasSubstr(message)) << what;
    auto again = relay.begin(holder, range(0), ask);
    relay.deliver(holder, asked, std::string(100, 'z'), "");
    EXPECT_EQ(relay.wait(again), std::string(100, 'z')) << what;
  }
  EXPECT_THAT(message_of([&] { relay.begin(holder, range(0), [](std::uint64_t) { return false; }); }),
              HasSubstr("gone"));
}

TEST(Relay, APieceOutlivesTheRelay) {
  auto relay = std::make_unique<Relay>();
  auto piece = relay->begin(holder, range(0), [](std::uint64_t) { return true; });
  relay.reset();
  piece.reset();
}

}  // namespace
}  // namespace gleaner::coordinator
