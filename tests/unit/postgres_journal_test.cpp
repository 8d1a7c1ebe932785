// The journal in a real PostgreSQL server of the test's own.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/postgres_journal.h"
#include "tests/farm/postgres_server.h"
#include "tests/unit/journal_rows.h"

namespace gleaner::test {
namespace {

using namespace coordinator;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

class PostgresJournal : public testing::Test {
 protected:
  void SetUp() override {
    if (const std::string why = PostgresServer::missing(); !why.empty()) GTEST_SKIP() << why;
    server_ = std::make_unique<PostgresServer>();
  }
  std::unique_ptr<Journal> open(double patience = 5) { return open_postgres_journal(server_->address(), patience); }

  std::unique_ptr<PostgresServer> server_;
};

TEST_F(PostgresJournal, WhatGoesInComesOut) {
  const std::string odd("\xff\0'z\\x41", 8);
  {
    auto journal = open();
    for (const char* id : {"b", "a", "c"}) journal->add(job(id), bytes_of(std::vector<char>{*id}));
    JournalChanges changes;
    changes.jobs["a"] = {.id = "a",
                         .state = "failed",
                         .message = odd,
                         .ended = 1.6e9 + 1.0 / 3,
                         .worker_seconds = 2.5,
                         .rays = ~std::uint64_t{0},
                         .request = {}};
    changes.frames_over = {{"a", 3, ""}, {"a", 1, odd}, {"b", 0, ""}};
    changes.ranges = {range("a", "x", 16), range("a", "x", 0), range("a", "y", 0, 1), range("c", "x", 0)};
    changes.forgotten = {"b"};
    journal->write(changes);
    journal->write(changes);  // as after a connection that was lost with the answer
  }
  auto journal = open();
  const auto jobs = journal->jobs();
  ASSERT_THAT(jobs, SizeIs(2));
  EXPECT_EQ(jobs[0].id, "a");
  EXPECT_EQ(jobs[0].state, "failed");
  EXPECT_EQ(jobs[0].message, odd);
  EXPECT_EQ(jobs[0].submitted, 1.5e9 + 0.1);
  EXPECT_EQ(jobs[0].ended, 1.6e9 + 1.0 / 3);
  EXPECT_EQ(jobs[0].worker_seconds, 2.5);
  EXPECT_EQ(jobs[0].rays, ~std::uint64_t{0});
  EXPECT_EQ(jobs[0].request, job("a").request);
  EXPECT_EQ(jobs[1].id, "c");
  EXPECT_EQ(journal->frames("c"), bytes_of(std::vector<char>{'c'}));
  EXPECT_THAT(journal->frames("b"), IsEmpty());
  const auto over = journal->frames_over("a");
  ASSERT_THAT(over, SizeIs(2));
  EXPECT_EQ(over[0].frame, 1u);
  EXPECT_EQ(over[0].failure, odd);
  EXPECT_EQ(over[1].frame, 3u);
  EXPECT_THAT(journal->frames_over("b"), IsEmpty());
  const auto ranges = journal->ranges("a", 0);
  ASSERT_THAT(ranges, SizeIs(2));
  EXPECT_EQ(ranges[0].first, 0u);
  EXPECT_EQ(ranges[1].offset, 128u);
  EXPECT_EQ(ranges[1].digest, range("a", "x", 16).digest);
  EXPECT_EQ(ranges[1].facts, range("a", "x", 16).facts);
  EXPECT_THAT(journal->ranges("a", 1), SizeIs(1));
}

TEST_F(PostgresJournal, WhatIsNoLongerNeededGoes) {
  auto journal = open();
  for (const char* id : {"a", "b"}) journal->add(job(id), {});
  JournalChanges changes;
  changes.ranges = {range("a", "x", 0), range("a", "x", 0, 1), range("b", "x", 0)};
  changes.frames_over = {{"a", 0, ""}, {"a", 1, "lost"}};
  journal->write(changes);
  changes = {};
  changes.dropped_frames = {{"a", 0}};
  changes.retried = {"a"};
  changes.ranges = {range("a", "z", 0)};
  journal->write(changes);
  ASSERT_THAT(journal->ranges("a", 0), SizeIs(1));
  EXPECT_EQ(journal->ranges("a", 0)[0].artifact, "z");
  EXPECT_THAT(journal->ranges("a", 1), SizeIs(1));
  ASSERT_THAT(journal->frames_over("a"), SizeIs(1)) << "no frame of a retried job has failed";
  changes = {};
  changes.dropped_jobs = {"a"};
  journal->write(changes);
  EXPECT_THAT(journal->ranges("a", 1), IsEmpty());
  EXPECT_THAT(journal->ranges("b", 0), SizeIs(1));
}

TEST_F(PostgresJournal, CountsItsStartsAndWritesWhollyOrNotAtAll) {
  EXPECT_EQ(open()->begin(), 1u);
  auto journal = open();
  EXPECT_EQ(journal->begin(), 2u);
  journal->add(job("a"), {});
  EXPECT_THAT(failure_of([&] { journal->add(job("a"), {}); }), HasSubstr("duplicate key"));
  JournalChanges changes;
  changes.jobs["a"] = {.id = "a", .state = "done", .message = {}, .request = {}};
  changes.ranges = {range(std::string("b\xff"), "x", 0)};  // no text
  EXPECT_THAT(failure_of([&] { journal->write(changes); }), HasSubstr("invalid byte sequence"));
  EXPECT_EQ(journal->jobs().at(0).state, "queued");
  journal->add(job("b"), {});
  EXPECT_THAT(journal->jobs(), SizeIs(2));
}

TEST_F(PostgresJournal, OneCoordinatorAtATime) {
  auto journal = open();
  EXPECT_THAT(failure_of([&] { open(0.3); }), HasSubstr("another coordinator is at work"));
  journal.reset();
  EXPECT_EQ(open()->begin(), 1u);
}

TEST_F(PostgresJournal, AServerThatDiesIsCalledAgain) {
  auto journal = open();
  journal->add(job("a"), {});
  JournalWriter writer(std::move(journal), {});
  server_->stop(SIGKILL);
  writer.changed({.id = "a", .state = "done", .message = {}, .request = {}});
  ASSERT_TRUE(eventually([&] { return !writer.trouble().empty(); }));
  EXPECT_THAT(writer.trouble(), HasSubstr("journal postgresql://"));
  server_->start();
  ASSERT_TRUE(eventually([&] { return writer.trouble().empty(); }, 60)) << writer.trouble();
  EXPECT_TRUE(writer.flush());
}

TEST(PostgresAddress, NoServerIsSaidWithoutThePassword) {
  const std::string why = failure_of([] { open_postgres_journal("postgresql://me:secret@127.0.0.1:1/gleaner", 0); });
  EXPECT_THAT(why, HasSubstr("journal postgresql://127.0.0.1:1/gleaner: "));
  EXPECT_THAT(why, HasSubstr("refused"));
  EXPECT_THAT(why, Not(HasSubstr("secret")));
}

}  // namespace
}  // namespace gleaner::test
