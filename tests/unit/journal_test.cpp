// The journal: what goes in comes out after the process has ended; what is wrong with its file is said.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <fstream>

#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/sqlite_journal.h"
#include "scene/model/error.h"
#include "tests/farm/fake_frame.h"
#include "tests/unit/journal_rows.h"

namespace gleaner::test {
namespace {

using namespace coordinator;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class SqliteJournal : public testing::Test {
 protected:
  std::unique_ptr<Journal> open(double patience = 5) { return open_sqlite_journal(file_, patience); }
  // A journal as a coordinator of an earlier version left it.
  void leave(const char* statements) {
    sqlite3* old = nullptr;
    ASSERT_EQ(sqlite3_open(file_.c_str(), &old), SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(old, statements, nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(old);
    sqlite3_close(old);
  }

  TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "j o\xff.sqlite";
};

TEST_F(SqliteJournal, JobsComeBackInTheirOrder) {
  const std::string odd("\xff\0z", 3);
  {
    auto journal = open();
    for (const char* id : {"b", "a", "c"}) journal->add(job(id), bytes_of(std::vector<char>{*id}));
    JournalChanges changes;
    changes.jobs["a"] = {.id = "a", .state = "failed", .message = odd, .ended = 1.6e9, .request = {}};
    changes.frames_over = {{"a", 3, ""}, {"a", 1, odd}, {"b", 0, ""}};
    changes.forgotten = {"b"};
    journal->write(changes);
  }
  auto journal = open();
  const auto jobs = journal->jobs();
  ASSERT_THAT(jobs, SizeIs(2));
  EXPECT_EQ(jobs[0].id, "a");
  EXPECT_EQ(jobs[0].state, "failed");
  EXPECT_EQ(jobs[0].message, odd);
  EXPECT_EQ(jobs[0].submitted, job("a").submitted);
  EXPECT_EQ(jobs[0].ended, 1.6e9);
  const auto over = journal->frames_over("a");
  ASSERT_THAT(over, SizeIs(2));
  EXPECT_EQ(over[0].frame, 1u);
  EXPECT_EQ(over[0].failure, odd);
  EXPECT_EQ(over[1].frame, 3u);
  EXPECT_EQ(over[1].failure, "");
  EXPECT_THAT(journal->frames_over("b"), IsEmpty()) << "it goes with its job";
  EXPECT_EQ(jobs[0].request, job("a").request);
  EXPECT_EQ(jobs[1].id, "c");
  EXPECT_EQ(journal->frames("c"), bytes_of(std::vector<char>{'c'}));
  EXPECT_THAT(journal->frames("b"), IsEmpty());
}

TEST_F(SqliteJournal, RangesComeBackUntilTheyAreNoLongerNeeded) {
  auto journal = open();
  for (const char* id : {"a", "b"}) journal->add(job(id), {});
  JournalChanges changes;
  changes.ranges = {range("a", "x", 16), range("a", "x", 0), range("a", "y", 0), range("b", "x", 0),
                    range("a", "x", 0, 1)};
  journal->write(changes);
  journal = open();
  const auto ranges = journal->ranges("a", 0);
  ASSERT_THAT(ranges, SizeIs(3));
  EXPECT_EQ(ranges[0].first, 0u) << "in the order of items";
  EXPECT_EQ(ranges[1].offset, 128u);
  EXPECT_EQ(ranges[1].count, 16u);
  EXPECT_EQ(ranges[1].bytes, 128u);
  EXPECT_EQ(ranges[1].digest, range("a", "x", 16).digest);
  EXPECT_EQ(ranges[1].facts, range("a", "x", 16).facts);
  changes = {};
  changes.dropped_frames = {{"a", 0}};
  changes.ranges = {range("a", "z", 0)};
  journal->write(changes);
  ASSERT_THAT(journal->ranges("a", 0), SizeIs(1));
  EXPECT_EQ(journal->ranges("a", 0)[0].artifact, "z") << "since it began again";
  EXPECT_THAT(journal->ranges("a", 1), SizeIs(1)) << "another frame";
  EXPECT_THAT(journal->ranges("b", 0), SizeIs(1)) << "another job";
  changes = {};
  changes.dropped_jobs = {"a"};
  journal->write(changes);
  EXPECT_THAT(journal->ranges("a", 0), IsEmpty());
  EXPECT_THAT(journal->ranges("a", 1), IsEmpty());
  EXPECT_THAT(journal->ranges("b", 0), SizeIs(1));
}

// What a coordinator of an earlier version left goes on: its first frames are written, its ranges are of the next one.
TEST_F(SqliteJournal, TheFirstLayoutIsBroughtUpToDate) {
  leave(R"(
    CREATE TABLE meta(starts INTEGER NOT NULL);
    INSERT INTO meta VALUES(4);
    CREATE TABLE jobs(place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL, message BLOB NOT NULL,
                      submitted REAL NOT NULL, ended REAL NOT NULL, frames_done INTEGER NOT NULL);
    CREATE TABLE requests(id TEXT PRIMARY KEY, request BLOB NOT NULL, frames BLOB NOT NULL);
    CREATE TABLE ranges(job TEXT NOT NULL, artifact TEXT NOT NULL, first INTEGER NOT NULL, count INTEGER NOT NULL,
                        place INTEGER NOT NULL, bytes INTEGER NOT NULL, digest BLOB NOT NULL, facts BLOB NOT NULL);
    CREATE INDEX ranges_of_job ON ranges(job, artifact);
    INSERT INTO jobs VALUES(1, 'a', 'queued', '', 1.5e9, 0, 3), (2, 'b', 'queued', '', 1.5e9, 0, 0);
    INSERT INTO requests VALUES('a', x'01', x'02'), ('b', x'', x'');
    INSERT INTO ranges VALUES('a', 'x', 0, 16, 8, 128, x'aa', x'');
    PRAGMA user_version = 1;)");
  ASSERT_FALSE(HasFailure());
  for (int again = 0; again < 2; ++again) {
    auto journal = open();
    ASSERT_THAT(journal->jobs(), SizeIs(2));
    EXPECT_EQ(journal->jobs()[0].id, "a");
    EXPECT_EQ(journal->jobs()[0].request, Bytes{std::byte{1}});
    const auto over = journal->frames_over("a");
    ASSERT_THAT(over, SizeIs(3));
    for (std::uint64_t frame = 0; frame < 3; ++frame) EXPECT_EQ(over[frame].frame, frame);
    EXPECT_EQ(over[2].failure, "");
    EXPECT_THAT(journal->frames_over("b"), IsEmpty());
    ASSERT_THAT(journal->ranges("a", 3), SizeIs(1));
    EXPECT_EQ(journal->ranges("a", 3)[0].bytes, 128u);
    EXPECT_THAT(journal->ranges("a", 0), IsEmpty());
    EXPECT_EQ(journal->jobs()[0].worker_seconds, 0);
  }
  EXPECT_EQ(open()->begin(), 5u);
}

TEST_F(SqliteJournal, TheSecondLayoutIsBroughtUpToDate) {
  leave(R"(
    CREATE TABLE meta(starts INTEGER NOT NULL);
    INSERT INTO meta VALUES(4);
    CREATE TABLE jobs(place INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL, message BLOB NOT NULL,
                      submitted REAL NOT NULL, ended REAL NOT NULL);
    CREATE TABLE requests(id TEXT PRIMARY KEY, request BLOB NOT NULL, frames BLOB NOT NULL);
    CREATE TABLE frames_over(job TEXT NOT NULL, frame INTEGER NOT NULL, failure BLOB NOT NULL, PRIMARY KEY(job, frame))
                             WITHOUT ROWID;
    CREATE TABLE ranges(job TEXT NOT NULL, artifact TEXT NOT NULL, first INTEGER NOT NULL, count INTEGER NOT NULL,
                        place INTEGER NOT NULL, bytes INTEGER NOT NULL, digest BLOB NOT NULL, facts BLOB NOT NULL,
                        frame INTEGER NOT NULL);
    INSERT INTO jobs VALUES(1, 'a', 'done', '', 1.5e9, 1.6e9);
    INSERT INTO requests VALUES('a', x'01', x'02');
    PRAGMA user_version = 2;)");
  ASSERT_FALSE(HasFailure());
  for (int again = 0; again < 2; ++again) {
    const auto jobs = open()->jobs();
    ASSERT_THAT(jobs, SizeIs(1));
    EXPECT_EQ(jobs[0].state, "done");
    EXPECT_EQ(jobs[0].rays, 0u);
    EXPECT_EQ(jobs[0].request, Bytes{std::byte{1}});
  }
}

TEST_F(SqliteJournal, ARetriedJobHasNoFailedFrames) {
  auto journal = open();
  journal->add({.id = "a", .state = "failed", .message = "no", .request = {}}, {});
  JournalChanges over;
  over.frames_over = {{.job = "a", .frame = 0, .failure = ""}, {.job = "a", .frame = 1, .failure = "lost"}};
  journal->write(over);
  JournalChanges again;
  again.retried = {"a"};
  again.jobs["a"] = {
      .id = "a", .state = "queued", .message = "", .worker_seconds = 2.5, .rays = 1ull << 40, .request = {}};
  journal->write(again);
  ASSERT_THAT(journal->frames_over("a"), SizeIs(1));
  EXPECT_EQ(journal->frames_over("a")[0].frame, 0u);
  EXPECT_EQ(journal->jobs()[0].state, "queued");
  EXPECT_EQ(journal->jobs()[0].worker_seconds, 2.5);
  EXPECT_EQ(journal->jobs()[0].rays, 1ull << 40);
}

TEST_F(SqliteJournal, CountsItsStarts) {
  EXPECT_EQ(open()->begin(), 1u);
  auto journal = open();
  EXPECT_EQ(journal->begin(), 2u);
  EXPECT_EQ(journal->begin(), 3u);
}

TEST_F(SqliteJournal, AWriteIsWholeOrNothing) {
  auto journal = open();
  journal->add(job("a"), {});
  EXPECT_THAT(failure_of([&] { journal->add(job("a"), {}); }), HasSubstr("UNIQUE"));
  EXPECT_THAT(journal->jobs(), SizeIs(1));
  journal->add(job("b"), {});
  EXPECT_THAT(journal->jobs(), SizeIs(2));
}

TEST_F(SqliteJournal, ADamagedFileIsRefusedByName) {
  {
    auto journal = open();
    for (int i = 0; i < 200; ++i) journal->add(job(std::to_string(i)), Bytes(2000));
  }
  {
    std::fstream file(file_, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(4096 * 3);
    file << std::string(4096 * 20, '#');
  }
  EXPECT_THAT(failure_of([&] { open(); }), testing::AllOf(HasSubstr("j o\\xff.sqlite"), HasSubstr("damaged")));
  std::ofstream(file_, std::ios::trunc) << "no journal at all, but longer than a header of one hundred bytes would be: "
                                           "what stands here is a letter, and nothing but a letter";
  EXPECT_THAT(failure_of([&] { open(); }), HasSubstr("damaged"));
  std::filesystem::remove(file_);
  std::filesystem::create_directory(file_);
  EXPECT_THAT(failure_of([&] { open(); }), HasSubstr("cannot be opened"));
}

TEST_F(SqliteJournal, WhoHoldsItLockedIsWaitedForNotForEver) {
  auto journal = open(0.05);
  sqlite3* other = nullptr;
  ASSERT_EQ(sqlite3_open(file_.c_str(), &other), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(other, "BEGIN IMMEDIATE", nullptr, nullptr, nullptr), SQLITE_OK);
  EXPECT_THAT(failure_of([&] { journal->add(job("a"), {}); }), HasSubstr("locked"));
  sqlite3_exec(other, "ROLLBACK", nullptr, nullptr, nullptr);
  sqlite3_close(other);
  journal->add(job("a"), {});
  EXPECT_THAT(journal->jobs(), SizeIs(1));
}

TEST_F(SqliteJournal, ANewerLayoutIsLeftAlone) {
  open();
  sqlite3* other = nullptr;
  ASSERT_EQ(sqlite3_open(file_.c_str(), &other), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(other, "PRAGMA user_version = 99", nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(other);
  EXPECT_THAT(failure_of([&] { open(); }), HasSubstr("newer version"));
}

// Fails as often as it is told to, and remembers what was written.
struct Memory {
  std::atomic<int> failures{0};
  std::mutex mutex;
  std::vector<JournalChanges> writes;
};
class FailingJournal final : public Journal {
 public:
  explicit FailingJournal(Memory& memory) : memory_(memory) {}
  std::string name() const override { return "a test's"; }
  std::uint64_t begin() override { return 1; }
  std::vector<JournalJob> jobs() override { return {}; }
  Bytes frames(const std::string&) override { return {}; }
  std::vector<JournalFrame> frames_over(const std::string&) override { return {}; }
  std::vector<JournalRange> ranges(const std::string&, std::uint64_t) override { return {}; }
  void add(const JournalJob&, const Bytes&) override {}
  void write(const JournalChanges& changes) override {
    std::lock_guard lock(memory_.mutex);
    if (memory_.failures > 0) {
      --memory_.failures;
      throw Error::failed("journal a test's: the disk is full");
    }
    memory_.writes.push_back(changes);
  }

 private:
  Memory& memory_;
};

TEST(JournalWriter, TriesAgainAndLosesNoJob) {
  Memory memory;
  memory.failures = 2;
  std::vector<std::string> said;
  bool cleaned = false;
  {
    JournalWriter writer(std::make_unique<FailingJournal>(memory),
                         [&](const std::string& line) { said.push_back(line); });
    writer.changed({.id = "a", .state = "queued", .message = {}, .request = {}});
    writer.accepted(range("a", "x", 0));
    writer.accepted(range("a", "x", 0, 1));
    ASSERT_TRUE(eventually([&] { return memory.failures < 2; }));
    ASSERT_TRUE(eventually([&] { return !writer.trouble().empty(); }));
    EXPECT_THAT(writer.trouble(), HasSubstr("the disk is full"));
    // What comes later stands above what could not be written.
    writer.changed({.id = "a", .state = "done", .message = {}, .request = {}});
    writer.frame_over({"a", 0, ""}, [&] { cleaned = true; });
    ASSERT_TRUE(eventually([&] { return writer.trouble().empty(); }));
  }
  ASSERT_THAT(memory.writes, SizeIs(1));
  EXPECT_EQ(memory.writes[0].jobs.at("a").state, "done");
  ASSERT_THAT(memory.writes[0].ranges, SizeIs(1)) << "none of a frame that is over";
  EXPECT_EQ(memory.writes[0].ranges[0].frame, 1u);
  ASSERT_THAT(memory.writes[0].frames_over, SizeIs(1));
  EXPECT_EQ(memory.writes[0].frames_over[0].frame, 0u);
  EXPECT_TRUE(cleaned) << "after the write, not before";
  EXPECT_THAT(said, SizeIs(2)) << "once that it fails, once that it does not";
}

TEST(JournalWriter, WritesTheRestWhenItEnds) {
  Memory memory;
  {
    JournalWriter writer(std::make_unique<FailingJournal>(memory), {});
    writer.accepted(range("a", "x", 0));
  }
  ASSERT_THAT(memory.writes, SizeIs(1));
  EXPECT_THAT(memory.writes[0].ranges, SizeIs(1));
}

}  // namespace
}  // namespace gleaner::test
